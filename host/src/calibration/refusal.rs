//! Why there is no calibration: one value a cause, with the numbers behind it. The words are in [`crate::remedy`].

use ftcal_shared::refusal::Refusal;

use super::turning::Swept;

/// A cause for not giving a calibration. Trials and known loads are numbered from zero.
#[derive(Clone, Debug, PartialEq)]
pub enum CalibrationRefusal {
    /// The estimator refused a trial.
    Trial {
        /// The trial.
        trial: usize,
        /// Its cause.
        refusal: Refusal,
    },
    /// Nothing says how a trial is oriented.
    NoKnownLoad {
        /// The trial.
        trial: usize,
    },
    /// The known loads of a trial leave a turn free, or all but free.
    KnownLoadsDoNotOrient {
        /// The trial.
        trial: usize,
        /// How many known loads it has.
        loads: usize,
        /// Standard deviation of the worst turn, degrees; infinite where it is free.
        uncertainty_deg: f64,
    },
    /// The angles between the known loads of a trial are not those between the recovered ones.
    KnownLoadsContradict {
        /// The trial.
        trial: usize,
        /// The load that is farthest off.
        load: usize,
        /// By how much, degrees.
        angle_deg: f64,
    },
    /// A known load is not of the magnitude that the trial turned.
    KnownLoadMagnitude {
        /// The trial.
        trial: usize,
        /// The load.
        load: usize,
        /// Its magnitude over that of the trial.
        magnitude: f64,
    },
    /// The sensor turned during a rest.
    KnownLoadNotAtRest {
        /// The trial.
        trial: usize,
        /// The load.
        load: usize,
        /// How far from the first half to the second, degrees.
        drift_deg: f64,
    },
    /// Every sample of a rest is saturated.
    KnownLoadSaturated {
        /// The trial.
        trial: usize,
        /// The load.
        load: usize,
    },
    /// The motion of a trial shows no plain sense of turning.
    TurningUnclear {
        /// The trial.
        trial: usize,
        /// How far it turned each way.
        swept: Swept,
    },
    /// The sense of turning and the known loads of a trial contradict each other.
    TurningContradicts {
        /// The trial.
        trial: usize,
    },
    /// A mirror image fits as well.
    HandednessNotSettled {
        /// The trials that may be mirrored.
        trials: Vec<usize>,
        /// By how much the mirror image fits worse, in variances.
        margin: f64,
        /// By how much it would have to.
        need: f64,
    },
    /// A mirror image fits as well: the known loads lie in the plane of the arms, or along its normal.
    LoadsInPlaneOfArms {
        /// The trials that may be mirrored.
        trials: Vec<usize>,
    },
    /// Too many trials may be mirrored to try all combinations.
    TooManyUndecided {
        /// The trials.
        trials: Vec<usize>,
    },
    /// The trials do not fit together: a mass, an arm or a direction is not what the session says.
    TrialsContradict {
        /// The fusion residual.
        residual: f64,
        /// The misfit in standard deviations.
        ratio: f64,
    },
    /// The trials fit together only if a mass is not what the session says.
    MassesContradict {
        /// The trial whose mass is farthest off.
        trial: usize,
        /// The mass that turned over the one that the session says, if the other masses are right.
        ratio: f64,
    },
    /// Fewer arms than the torques need.
    TooFewArms {
        /// Arms at hand.
        have: usize,
        /// Arms needed.
        need: usize,
    },
    /// All arms are the same.
    ArmsEqual {
        /// How many.
        arms: usize,
        /// How far apart they are, metre.
        spread_m: f64,
    },
    /// All arms end on one line: the torque about it is never seen.
    ArmsCollinear {
        /// How many.
        arms: usize,
    },
    /// The arms are too close together for what the directions, arms and masses are known to.
    FusionUncertain {
        /// The predicted error of a wrench, relative.
        wrench_error: f64,
        /// The largest that is accepted.
        need: f64,
    },
    /// The trials disagree about the codes without load.
    BiasesDisagree {
        /// The trial that is farthest off.
        trial: usize,
        /// Its distance from the others, counts.
        counts: f64,
        /// The signal of its load, counts.
        signal_counts: f64,
    },
    /// Fewer gages than degrees of freedom.
    TooFewGages {
        /// Gages.
        gages: usize,
        /// Gages needed.
        need: usize,
    },
    /// The sensor does not respond to some component of the load.
    ShapeRankDeficient,
    /// Fewer known loads than least squares needs.
    TooFewKnownLoads {
        /// Known loads at hand.
        have: usize,
        /// Known loads needed.
        need: usize,
    },
    /// The known loads do not span all components of the load.
    KnownLoadsDoNotSpan {
        /// Components that they span.
        have: usize,
        /// Components needed.
        need: usize,
    },
    /// The gages do not follow the known loads: no matrix relates them.
    KnownLoadsNotLinear {
        /// The part of the loads that the matrix does not explain, relative.
        residual: f64,
        /// The largest that is accepted.
        need: f64,
    },
    /// The sensor is not linear at the load of a trial.
    NotLinear {
        /// The trial.
        trial: usize,
        /// Standard deviation of the codes in the first direction that no load should move, counts.
        redundant_counts: f64,
        /// Noise of one channel at rest, counts.
        rest_counts: f64,
        /// The signal of the load, counts.
        signal_counts: f64,
    },
    /// A trial does not look like the stored calibration from any side.
    ReferenceDiffers {
        /// The trial.
        trial: usize,
        /// The part of the stored shape that the trial's does not match, relative.
        drift: f64,
        /// The same for the trial's mirror image.
        other_hand: f64,
        /// The size of the trial's shape over that of the stored one.
        scale: f64,
        /// The largest drift that is told from a turn.
        need: f64,
    },
    /// A trial has other gages than the stored calibration.
    GagesDiffer {
        /// The trial.
        trial: usize,
        /// Its gages.
        gages: usize,
        /// Those of the stored calibration.
        stored: usize,
    },
    /// A result is not finite.
    NonFinite,
}

impl CalibrationRefusal {
    /// The same refusal with its trials numbered otherwise.
    #[must_use]
    pub fn renumbered(mut self, number: impl Fn(usize) -> usize) -> Self {
        match &mut self {
            Self::Trial { trial, .. }
            | Self::NoKnownLoad { trial }
            | Self::KnownLoadsDoNotOrient { trial, .. }
            | Self::KnownLoadsContradict { trial, .. }
            | Self::KnownLoadMagnitude { trial, .. }
            | Self::KnownLoadNotAtRest { trial, .. }
            | Self::KnownLoadSaturated { trial, .. }
            | Self::TurningUnclear { trial, .. }
            | Self::TurningContradicts { trial }
            | Self::MassesContradict { trial, .. }
            | Self::BiasesDisagree { trial, .. }
            | Self::NotLinear { trial, .. }
            | Self::GagesDiffer { trial, .. }
            | Self::ReferenceDiffers { trial, .. } => *trial = number(*trial),
            Self::HandednessNotSettled { trials, .. }
            | Self::LoadsInPlaneOfArms { trials }
            | Self::TooManyUndecided { trials } => {
                for trial in trials {
                    *trial = number(*trial);
                }
            }
            Self::TrialsContradict { .. }
            | Self::TooFewArms { .. }
            | Self::ArmsEqual { .. }
            | Self::ArmsCollinear { .. }
            | Self::FusionUncertain { .. }
            | Self::TooFewGages { .. }
            | Self::ShapeRankDeficient
            | Self::TooFewKnownLoads { .. }
            | Self::KnownLoadsDoNotSpan { .. }
            | Self::KnownLoadsNotLinear { .. }
            | Self::NonFinite => {}
        }
        self
    }
}
