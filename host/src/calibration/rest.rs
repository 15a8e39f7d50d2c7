//! Which samples of a recording were taken at rest, with a number of gages known at run time only.

use ftcal_shared::estimation::gate::Quietness;
use nalgebra::DVector;

use super::samples::{Outcome, Rejection, SampleCounts, gated, rejected};
use crate::recording::Recording;

/// The fewest samples at rest that are worth leaving out all others for: about four blocks of the gate.
const LEAST_REST: usize = 16;

/// The samples of a recording that count.
#[derive(Clone, Debug)]
pub struct Rested {
    /// Their codes in counts (p each).
    pub counts: Vec<DVector<f64>>,
    /// How many they are, and why the others do not count.
    pub samples: SampleCounts,
}

/// The samples at rest; where there are next to none, all that are measurements. `None` of no measurement.
pub fn rested(recording: &Recording) -> Option<Rested> {
    let outcomes = outcomes(recording);
    let still = |outcome: &Outcome| *outcome == Outcome::Measured(Quietness::Still);
    let measured = |outcome: &Outcome| matches!(outcome, Outcome::Measured(_));
    let at_rest = outcomes.iter().filter(|&outcome| still(outcome)).count();
    let takes: &dyn Fn(&Outcome) -> bool = if at_rest >= LEAST_REST { &still } else { &measured };
    let counts: Vec<DVector<f64>> = recording
        .samples()
        .zip(&outcomes)
        .filter(|(_, outcome)| takes(outcome))
        .map(|((_, codes), _)| recording.counts(codes))
        .collect();
    let count = |cause| (cause, rejected(&outcomes, cause));
    let moving = outcomes.iter().filter(|&outcome| measured(outcome) && !takes(outcome)).count() as u64;
    let samples = SampleCounts::new(
        outcomes.len() as u64,
        &[count(Rejection::Saturated), count(Rejection::Repeated), (Rejection::Moving, moving)],
    );
    (!counts.is_empty()).then_some(Rested { counts, samples })
}

/// What becomes of the samples of a recording of any number of gages.
fn outcomes(recording: &Recording) -> Vec<Outcome> {
    match recording.gages() {
        2 => gated::<2>(recording, None),
        3 => gated::<3>(recording, None),
        4 => gated::<4>(recording, None),
        5 => gated::<5>(recording, None),
        6 => gated::<6>(recording, None),
        7 => gated::<7>(recording, None),
        8 => gated::<8>(recording, None),
        9 => gated::<9>(recording, None),
        10 => gated::<10>(recording, None),
        11 => gated::<11>(recording, None),
        12 => gated::<12>(recording, None),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{AdcCode, Dof};
    use nalgebra::DVector;

    use super::rested;
    use crate::calibration::samples::Rejection;
    use crate::calibration::synthetic::{Sensor, flat};
    use crate::recording::Recording;
    use crate::session_file::STANDARD_GRAVITY;

    #[test]
    fn of_a_turn_between_two_rests_the_rests_count() {
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, 1);
        let mut directions: Vec<DVector<f64>> = vec![flat(0.0); 400];
        directions.extend((0..200).map(|step| flat(f64::from(step) * 0.01)));
        directions.extend(vec![flat(2.0); 400]);
        let found = rested(&sensor.record(1.0, &[], &directions)).expect("measurements");
        let moving = *found.samples.rejected.get(&Rejection::Moving).expect("the turn");
        assert_eq!(found.counts.len() as u64, found.samples.used);
        assert_eq!(found.samples.used + moving, 1000);
        // Chance and the ends of the rests cost some of them, the turn gives nothing: a step of it is ten times the noise.
        assert!((640..=800).contains(&found.samples.used), "{:?}", found.samples);
        for counts in &found.counts {
            let nearest = [flat(0.0), flat(2.0)].map(|direction| {
                let rest = &sensor.bias_counts + sensor.shape.transpose() * direction * STANDARD_GRAVITY;
                (counts - rest).norm()
            });
            assert!(nearest[0].min(nearest[1]) < 10.0 * sensor.noise_counts, "{nearest:?}");
        }
    }

    #[test]
    fn what_never_rests_counts_as_a_whole_and_what_is_no_measurement_does_not() {
        let mut sensor = Sensor::new(Dof::PlanarForce, 4, 2);
        let directions: Vec<DVector<f64>> = (0..500).map(|step| flat(f64::from(step) * 0.05)).collect();
        let found = rested(&sensor.record(1.0, &[], &directions)).expect("measurements");
        assert_eq!(found.samples.used, 500);
        let saturated = Recording::from_codes(4, vec![0.0; 3], vec![AdcCode::MAX; 12]);
        assert!(rested(&saturated).is_none());
    }
}
