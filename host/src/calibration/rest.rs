//! Which samples of a recording are measurements, and which of those were taken at rest: the sensor's own gate
//! ([`ftcal_shared::estimation::gate`]), with a number of gages known at run time only.

use ftcal_shared::estimation::gate::{Gate, Quietness, Verdict};
use ftcal_shared::units::AdcCode;
use nalgebra::DVector;

use super::trial::{Rejection, SampleCounts};
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
    let verdicts = verdicts(recording);
    let still = |outcome: &Outcome| *outcome == Outcome::Measured(Quietness::Still);
    let measured = |outcome: &Outcome| matches!(outcome, Outcome::Measured(_));
    let at_rest = verdicts.iter().filter(|&outcome| still(outcome)).count();
    let takes: &dyn Fn(&Outcome) -> bool = if at_rest >= LEAST_REST { &still } else { &measured };
    let counts: Vec<DVector<f64>> = recording
        .samples()
        .zip(&verdicts)
        .filter(|(_, outcome)| takes(outcome))
        .map(|((_, codes), _)| recording.counts(codes))
        .collect();
    let rejected =
        |cause: &dyn Fn(&Outcome) -> bool| verdicts.iter().filter(|&outcome| cause(outcome)).count() as u64;
    let samples = SampleCounts::new(
        verdicts.len() as u64,
        &[
            (Rejection::Saturated, rejected(&|outcome| *outcome == Outcome::Rejected(Rejection::Saturated))),
            (Rejection::Repeated, rejected(&|outcome| *outcome == Outcome::Rejected(Rejection::Repeated))),
            (Rejection::Moving, rejected(&|outcome| measured(outcome) && !takes(outcome))),
        ],
    );
    (!counts.is_empty()).then_some(Rested { counts, samples })
}

/// What became of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Outcome {
    Rejected(Rejection),
    Measured(Quietness),
}

fn verdicts(recording: &Recording) -> Vec<Outcome> {
    match recording.gages() {
        2 => of_gages::<2>(recording),
        3 => of_gages::<3>(recording),
        4 => of_gages::<4>(recording),
        5 => of_gages::<5>(recording),
        6 => of_gages::<6>(recording),
        7 => of_gages::<7>(recording),
        8 => of_gages::<8>(recording),
        9 => of_gages::<9>(recording),
        10 => of_gages::<10>(recording),
        11 => of_gages::<11>(recording),
        12 => of_gages::<12>(recording),
        _ => Vec::new(),
    }
}

fn of_gages<const GAGES: usize>(recording: &Recording) -> Vec<Outcome> {
    let mut gate = Gate::<GAGES>::new();
    // The gate classes what it accepts some samples later, in order.
    let mut classes = Vec::with_capacity(recording.len());
    let mut note = |class, _: &[AdcCode; GAGES]| classes.push(class);
    let codes = recording.samples().filter_map(|(_, codes)| <&[AdcCode; GAGES]>::try_from(codes).ok());
    let verdicts: Vec<Verdict> = codes.map(|codes| gate.offer(codes, &mut note)).collect();
    gate.finish(&mut note);
    let mut classes = classes.into_iter();
    let outcome = |verdict| match verdict {
        Verdict::Saturated => Outcome::Rejected(Rejection::Saturated),
        Verdict::Repeated => Outcome::Rejected(Rejection::Repeated),
        // Only of a gate that is told what to expect.
        Verdict::Contradictory => Outcome::Rejected(Rejection::Parity),
        Verdict::Accepted => Outcome::Measured(classes.next().unwrap_or(Quietness::Fast)),
    };
    verdicts.into_iter().map(outcome).collect()
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{AdcCode, Dof};
    use nalgebra::DVector;

    use super::rested;
    use crate::calibration::synthetic::{Sensor, flat};
    use crate::calibration::trial::Rejection;
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
