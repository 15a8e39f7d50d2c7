//! What a trial has covered, in the recording's counts and in words a person can follow.
//!
//! The trial's own frame is arbitrary, so that "towards −y" means nothing before it is oriented. The gages are what a
//! person sees: "turn the load so that ch3 reads low, near −51200 counts". How a direction becomes gages is told in
//! [`ftcal_shared::estimation::coverage`].

use ftcal_shared::estimation::coverage::{self, coverage, progress};
use ftcal_shared::estimation::shape::TrialSolution;
use ftcal_shared::refusal::Refusal;
use ftcal_shared::wire;

use crate::recording::quantisation::Quantisation;

/// From this share of its range on, a gage reads high (or low).
const HIGH: f64 = 0.7;

/// What a trial has covered.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialCoverage {
    /// The share of all directions, 0 to 1.
    pub fraction: f64,
    /// The largest predicted standard deviation of a gain, cross-talk or offset, relative to the load.
    pub worst_relative_uncertainty: f64,
    /// What the gages read where the next samples tell most.
    pub targets: Vec<Target>,
}

/// What one gage reads with the load where it is to be turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// The gage, counted from zero.
    pub gage: u8,
    /// Its reading, counts.
    pub counts: f64,
    /// Where that stands in its range, −1 to 1.
    pub position: f64,
}

impl TrialCoverage {
    /// The coverage of a solution in codes, in the counts that this quantisation gives.
    ///
    /// # Errors
    ///
    /// Those of [`coverage()`].
    pub fn new<const GAGES: usize>(
        solution: &TrialSolution<GAGES>,
        quantisation: &Quantisation,
    ) -> Result<Self, Refusal> {
        let (step, offsets) = (quantisation.counts_per_code(), quantisation.offset_counts());
        let covered = coverage(solution)?;
        let target = |target: &coverage::GageTarget| Target {
            counts: target.counts * step + offsets.get(usize::from(target.gage)).copied().unwrap_or_default(),
            gage: target.gage,
            position: target.position,
        };
        Ok(Self {
            fraction: covered.fraction,
            worst_relative_uncertainty: covered.worst_relative_uncertainty,
            targets: covered.targets.iter().map(target).collect(),
        })
    }

    /// Which way to turn the load next, in words.
    pub fn weakest_direction(&self) -> String {
        let targets: Vec<String> = self.targets.iter().map(Target::in_words).collect();
        format!("turn the load so that {}", targets.join(" and "))
    }

    /// How far the trial is where this relative uncertainty is asked for, 0 to 1.
    pub fn progress(&self, asked: f64) -> f64 {
        progress(self.worst_relative_uncertainty, asked)
    }
}

impl Target {
    fn in_words(&self) -> String {
        let Self { gage, counts, position } = *self;
        let level = if position >= HIGH {
            "high, "
        } else if position <= -HIGH {
            "low, "
        } else {
            ""
        };
        // Three digits of a reading are more than a hand can hit.
        format!("ch{gage} reads {level}near {counts:.*} counts", if counts.abs() < 10.0 { 3 } else { 0 })
    }
}

/// What the sensor tells of its own trial.
impl From<&wire::Coverage> for TrialCoverage {
    fn from(covered: &wire::Coverage) -> Self {
        let target = |target: &wire::GageTarget| Target {
            gage: target.gage,
            counts: target.counts.into(),
            position: target.position.into(),
        };
        Self {
            fraction: covered.fraction.into(),
            worst_relative_uncertainty: covered.worst_relative_uncertainty.into(),
            targets: covered.targets.iter().map(target).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Dof;
    use nalgebra::DVector;

    use super::TrialCoverage;
    use crate::calibration::synthetic::{Sensor, sphere};
    use crate::calibration::trial::{Gating, solve};
    use crate::recording::Recording;

    fn covered(recording: &Recording) -> TrialCoverage {
        solve(recording, 3, Gating::On).expect("the motion spans").coverage
    }

    /// The directions of a cap about z.
    fn cap(least_height: f64) -> Vec<DVector<f64>> {
        sphere(4000).into_iter().filter(|direction| direction[2] >= least_height).collect()
    }

    #[test]
    fn the_fraction_of_a_cap_is_its_area() {
        let mut sensor = Sensor::new(Dof::SpatialForce, 8, 1);
        // The degrees beyond four are missing: up to 0.06 for these (computed from Legendre polynomials by hand).
        for (least_height, area) in [(-1.0, 1.0), (-0.5, 0.75), (0.0, 0.5)] {
            let fraction = covered(&sensor.record(1.0, &[], &cap(least_height))).fraction;
            assert!((fraction - area).abs() < 0.06, "{fraction} for {area}");
        }
    }

    #[test]
    fn the_gages_named_point_to_where_the_load_has_not_been() {
        for seed in 0..20 {
            let mut sensor = Sensor::new(Dof::SpatialForce, 8, seed);
            let coverage = covered(&sensor.record(1.0, &[], &cap(-0.3)));
            // What these gages read there is what the missing pole gives, within the 30° of the search and the 26° to
            // which gages pin a direction down.
            let newton = crate::session_file::STANDARD_GRAVITY;
            for target in &coverage.targets {
                let sensitivity = sensor.shape.column(usize::from(target.gage)) * newton;
                let at_pole = sensor.bias_counts[usize::from(target.gage)] - sensitivity[2];
                let allowed = (30.0_f64 + 26.0).to_radians().sin() * sensitivity.norm();
                assert!((target.counts - at_pole).abs() < allowed, "{}", coverage.weakest_direction());
            }
            assert!(!coverage.targets.is_empty());
        }
    }
}
