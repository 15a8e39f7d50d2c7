//! Arms and loads that do not settle the answer, or hardly, and sessions that contradict themselves: is it refused, and if not,
//! is it right?
//!
//! A **wrong answer** is one that
//!
//! 1. reads some wrench, torques taken at the arm at which they answer as forces do, wrong by more than 5 % of it, *and*
//! 2. errs in some element of the calibration matrix by more than six of the standard deviations that it predicts for it. Those
//!    contain what the stated accuracies of arms, masses and directions allow.
//!
//! So an answer that is far off but says so is none, and one that is off by a trifle is none. Where the session says something
//! false ([`crate::contradiction`]), the same holds: a falsehood that does no harm may pass. Refusing is never wrong here.
//! Sessions that claim another number of dimensions than the load had have no right answer: any is wrong.

use ftcal::calibration::known_load::LoadCase;
use ftcal::calibration::{Calibration, CalibrationRefusal, SolvedTrial, calibrate};
use ftcal::session_file::STANDARD_GRAVITY;
use ftcal_shared::units::Dof;
use ftcal_tests::random;
use nalgebra::DVector;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::arrangement::{elevated, normal_of, spread};
use crate::contradiction::{Fault, oblique, wrong_arms, wrong_mass};
use crate::degenerate::Outcome;
use crate::session::{
    Direction, Hung, ROUGH_RAD, WrenchSensor, all_round, exact_case, known, normal, rough, turned, unit,
};

/// Share of a wrench by which an answer may be off whatever it says.
const SHARE: f64 = 0.05;

/// Predicted standard deviations by which it may be off whatever its share.
const DEVIATIONS: f64 = 6.0;

/// Samples of a trial.
const SAMPLES: usize = 600;

/// What is the matter with a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Doubt {
    /// One arm fewer than needed, or one of them twice.
    TooFewArms,
    /// All arms on a line, or close to it (in the plane: on a point).
    ArmsInLine,
    /// All arms at a point, or close to it.
    ArmsAtPoint,
    /// Precise known loads in the plane of the arms, or close to it.
    LoadsInArmsPlane,
    /// One rough direction a trial, at any angle to the plane of the arms.
    RoughDirections,
    /// Known loads of one trial alone, and one more arm, which may be of no use.
    OneTrialOriented,
    /// Precise known loads in one direction, or close to it.
    ParallelLoads,
    /// A sensor that hardly answers to some wrench.
    DeafSensor,
    /// A sensor without torques, and one known load fewer than tells the hand.
    ForceMirrored,
    /// A sensor without torques, and known loads close to one plane (in the plane: to one line).
    ForceLoadsInPlane,
    /// Something is false.
    False(Fault),
    /// The same for a sensor without torques.
    ForceFalse(Fault),
    /// The load has another number of dimensions than the session says.
    WrongRank,
}

/// Every one of them.
pub(crate) const DOUBTS: [Doubt; 18] = [
    Doubt::TooFewArms,
    Doubt::ArmsInLine,
    Doubt::ArmsAtPoint,
    Doubt::LoadsInArmsPlane,
    Doubt::RoughDirections,
    Doubt::OneTrialOriented,
    Doubt::ParallelLoads,
    Doubt::DeafSensor,
    Doubt::ForceMirrored,
    Doubt::ForceLoadsInPlane,
    Doubt::False(Fault::WrongMass),
    Doubt::False(Fault::SwappedArms),
    Doubt::False(Fault::FlippedArm),
    Doubt::False(Fault::MisplacedArm),
    Doubt::False(Fault::FlippedDirection),
    Doubt::ForceFalse(Fault::WrongMass),
    Doubt::ForceFalse(Fault::FlippedDirection),
    Doubt::WrongRank,
];

/// One case: its seed chooses the sensor, noise, accuracies and the rest. Every second one is planar.
pub(crate) fn case(doubt: Doubt, seed: u64) -> Outcome {
    let mut rng = random(seed);
    let rank = rng.random_range(2..=3);
    if doubt == Doubt::WrongRank {
        return wrong_rank(rank, &mut rng);
    }
    let session = loop {
        if let Some(session) = Session::new(doubt, rank, &mut rng) {
            break session;
        }
    };
    let (sensor, answer) = session.calibrated(&mut rng);
    match answer {
        Err(_) => Outcome::Refused,
        Ok(calibration) => judge(&sensor, &calibration),
    }
}

/// Conditions are written so that a number that is none is wrong.
fn judge(sensor: &WrenchSensor, calibration: &Calibration) -> Outcome {
    let right =
        sensor.worst_error(&calibration.matrix) <= SHARE || sensor.worst_deviation(calibration) <= DEVIATIONS;
    if right { Outcome::Right } else { Outcome::Wrong }
}

/// A session: the truth, and what is said of it.
struct Session {
    dof: Dof,
    hung: Vec<Hung>,
    stated_arms_m: Vec<DVector<f64>>,
    stated_masses_kg: Vec<f64>,
    arm_accuracy_m: f64,
    mass_accuracy: f64,
    /// For each trial.
    directions: Vec<Vec<Direction>>,
    /// What the sensor's answer to one random wrench is multiplied by.
    deafness: f64,
}

impl Session {
    /// `None` where the doubt does not show in this arrangement.
    fn new(doubt: Doubt, rank: usize, rng: &mut ChaCha8Rng) -> Option<Self> {
        let spatial = rank == 3;
        let torque = !matches!(doubt, Doubt::ForceMirrored | Doubt::ForceLoadsInPlane | Doubt::ForceFalse(_));
        let dof = match (spatial, torque) {
            (true, true) => Dof::SpatialForceTorque,
            (true, false) => Dof::SpatialForce,
            (false, true) => Dof::PlanarForceTorque,
            (false, false) => Dof::PlanarForce,
        };
        let arms_m = if torque { arms(doubt, rank, rng) } else { bare(doubt, rng) };
        let hung: Vec<Hung> = arms_m
            .iter()
            .map(|arm_m| Hung { mass_kg: rng.random_range(1.0..3.0), arm_m: arm_m.clone() })
            .collect();
        let arm_accuracy_m = pick(&[1e-5, 1e-4, 2e-4, 1e-3], rng);
        // A contradiction must be large for the accuracy.
        let contradicts = matches!(doubt, Doubt::False(_) | Doubt::ForceFalse(_));
        let mass_accuracy = if contradicts { 1e-3 } else { pick(&[1e-4, 1e-3, 1e-2], rng) };
        let upwards = if torque { normal_of(&arms_m) } else { unit(rank, rng) };
        let mut directions: Vec<Vec<Direction>> =
            (0..hung.len()).map(|trial| directions(doubt, trial, &upwards, rng)).collect();
        let mut stated_arms_m: Vec<DVector<f64>> =
            arms_m.iter().map(|arm| arm.map(|component| component + arm_accuracy_m * normal(rng))).collect();
        let mut stated_masses_kg: Vec<f64> =
            hung.iter().map(|hung| hung.mass_kg * (1.0 + mass_accuracy * normal(rng))).collect();
        if let Doubt::False(fault) | Doubt::ForceFalse(fault) = doubt {
            let trial = rng.random_range(0..hung.len());
            match fault {
                Fault::WrongMass => stated_masses_kg[trial] = wrong_mass(stated_masses_kg[trial], rng),
                Fault::SwappedArms | Fault::FlippedArm | Fault::MisplacedArm => {
                    stated_arms_m = wrong_arms(fault, &stated_arms_m, rng)?;
                }
                Fault::FlippedDirection => {
                    let truths: Vec<DVector<f64>> =
                        directions[trial].iter().map(|direction| direction.truth.clone()).collect();
                    let flipped = if truths.len() == 1 { 0 } else { oblique(&truths)? };
                    directions[trial][flipped].stated.neg_mut();
                }
            }
        }
        let deafness = if doubt == Doubt::DeafSensor { logarithmic(1e-4, 0.3, rng) } else { 1.0 };
        Some(Self {
            dof,
            hung,
            stated_arms_m,
            stated_masses_kg,
            arm_accuracy_m,
            mass_accuracy,
            directions,
            deafness,
        })
    }

    fn calibrated(&self, rng: &mut ChaCha8Rng) -> (WrenchSensor, Result<Calibration, CalibrationRefusal>) {
        let components = self.dof.count();
        let gages = components + rng.random_range(0..=(8 - components).min(3));
        let mut sensor = WrenchSensor::random(self.dof, gages, rng);
        sensor.deafen(self.deafness, rng);
        let noise = pick(&[1e-4, 1e-3, 1e-2, 0.03], rng);
        let sensor = sensor.with_relative_noise(noise, &self.hung);
        let trials: Result<Vec<SolvedTrial>, CalibrationRefusal> =
            (0..self.hung.len()).map(|trial| self.trial(trial, &sensor, rng)).collect();
        let answer = trials.and_then(|trials| calibrate(self.dof, STANDARD_GRAVITY, &trials));
        (sensor, answer)
    }

    fn trial(
        &self,
        trial: usize,
        sensor: &WrenchSensor,
        rng: &mut ChaCha8Rng,
    ) -> Result<SolvedTrial, CalibrationRefusal> {
        let hung = &self.hung[trial];
        let recording = sensor.record(hung, &all_round(self.dof.trial_rank(), SAMPLES, rng), rng);
        let mass_kg = self.stated_masses_kg[trial];
        let case = LoadCase {
            name: "trial.csv".to_owned(),
            mass_kg,
            arm_m: self.stated_arms_m[trial].clone(),
            arm_accuracy_m: self.arm_accuracy_m,
            mass_accuracy_kg: self.mass_accuracy * mass_kg,
            known_loads: sensor.known_loads(hung, &self.directions[trial], rng),
        };
        sensor.solved(&recording, case).map_err(|refusal| CalibrationRefusal::Trial { trial, refusal })
    }
}

/// The true arms, metre.
fn arms(doubt: Doubt, rank: usize, rng: &mut ChaCha8Rng) -> Vec<DVector<f64>> {
    let mut arms = spread(rank, rng.random_range(0.05..0.15), rng);
    let middle = arms.iter().sum::<DVector<f64>>() / arms.len() as f64;
    let nearly = if rng.random() { 0.0 } else { logarithmic(1e-4, 1.0, rng) };
    match doubt {
        Doubt::TooFewArms => {
            arms.pop();
            if rng.random() {
                // One of them twice, or one more on their line.
                let along = if rng.random() { 0.0 } else { rng.random_range(-1.0..2.0) };
                arms.push(&arms[0] + (&arms[arms.len() - 1] - &arms[0]) * along);
            }
        }
        Doubt::ArmsInLine if rank == 3 => {
            let between = (&arms[0] + &arms[1]) / 2.0;
            let off = &arms[2] - &between;
            let along = (&arms[1] - &arms[0]) * rng.random_range(-1.0..1.0);
            arms[2] = between + along + off * nearly;
        }
        Doubt::ArmsInLine | Doubt::ArmsAtPoint => {
            for arm in &mut arms {
                *arm = &middle + (&*arm - &middle) * nearly;
            }
        }
        Doubt::OneTrialOriented => {
            // On the line of two arms of the three (in the plane: at one of the two), the other trial may be mirrored alone.
            let along = if rank == 3 { rng.random_range(-1.0..2.0) } else { 0.0 };
            let line = &arms[0] + (&arms[1] - &arms[0]) * along;
            arms.push(line + unit(rank, rng) * (0.1 * nearly));
        }
        // In the plane, the third arm makes a triangle whose proportions can be wrong.
        Doubt::False(_) if rank == 2 => {
            let off = normal_of(&arms) * rng.random_range(0.05..0.15);
            arms.push(&middle + off);
        }
        _ => {}
    }
    arms
}

/// No arms: one to three trials, and two at least where masses are compared.
fn bare(doubt: Doubt, rng: &mut ChaCha8Rng) -> Vec<DVector<f64>> {
    let least = if doubt == Doubt::ForceFalse(Fault::WrongMass) { 2 } else { 1 };
    vec![DVector::zeros(0); rng.random_range(least..=3)]
}

/// The known loads of one trial.
fn directions(doubt: Doubt, trial: usize, normal: &DVector<f64>, rng: &mut ChaCha8Rng) -> Vec<Direction> {
    let rank = normal.len();
    let accuracy = pick(&[1e-3, 5e-3, 0.02], rng);
    let nearly = if rng.random() { 0.0 } else { logarithmic(1e-4, 0.5, rng) };
    let loads = rng.random_range(rank..=rank + 2);
    let off = rng.random_range(0.0..=ROUGH_RAD);
    let precise = |count: usize, rng: &mut ChaCha8Rng| -> Vec<Direction> {
        (0..count)
            .map(|_| unit(rank, rng))
            .collect::<Vec<_>>()
            .iter()
            .map(|truth| known(truth, accuracy, rng))
            .collect()
    };
    match doubt {
        Doubt::LoadsInArmsPlane | Doubt::ForceLoadsInPlane => {
            let mut lift = || elevated(normal, nearly * rng.random_range(-1.0..1.0), rng);
            let truths: Vec<DVector<f64>> = (0..loads).map(|_| lift()).collect();
            truths.iter().map(|truth| known(truth, accuracy, rng)).collect()
        }
        Doubt::RoughDirections => {
            let elevation = rng.random_range(0.0..core::f64::consts::FRAC_PI_2);
            vec![rough(&elevated(normal, elevation, rng), off, rng)]
        }
        Doubt::OneTrialOriented if trial > 0 => Vec::new(),
        Doubt::ParallelLoads => {
            let one = unit(rank, rng);
            let truths: Vec<DVector<f64>> = (0..loads)
                .map(|_| {
                    turned(&one, nearly * rng.random_range(-1.0..1.0), rng)
                        * if rng.random() { 1.0 } else { -1.0 }
                })
                .collect();
            truths.iter().map(|truth| known(truth, accuracy, rng)).collect()
        }
        Doubt::ForceMirrored => precise(rank - 1, rng),
        Doubt::ForceFalse(_) => precise(rank + 2, rng),
        // Well off the plane and its normal, where a rough direction tells every answer from every other.
        _ if rng.random() => {
            let elevation = rng.random_range(35_f64.to_radians()..55_f64.to_radians());
            vec![rough(&elevated(normal, elevation, rng), off, rng)]
        }
        _ => precise(rank + 1, rng),
    }
}

/// A sensor of the plane whose load turns in space, or one of space whose load turns in the plane: any answer is wrong.
fn wrong_rank(rank: usize, rng: &mut ChaCha8Rng) -> Outcome {
    let (claimed, truly) =
        if rank == 3 { (Dof::SpatialForce, Dof::PlanarForce) } else { (Dof::PlanarForce, Dof::SpatialForce) };
    let hung = Hung { mass_kg: 1.0, arm_m: DVector::zeros(0) };
    let sensor = WrenchSensor::random(truly, rng.random_range(3..=8), rng);
    let mut sensor =
        sensor.with_relative_noise(pick(&[1e-4, 1e-3, 1e-2, 0.03], rng), core::slice::from_ref(&hung));
    let recording = sensor.record(&hung, &all_round(truly.trial_rank(), SAMPLES, rng), rng);
    sensor.dof = claimed;
    let case = exact_case(&hung, Vec::new());
    if sensor.solved(&recording, case).is_ok() { Outcome::Wrong } else { Outcome::Refused }
}

fn pick(values: &[f64], rng: &mut ChaCha8Rng) -> f64 {
    values[rng.random_range(0..values.len())]
}

/// Equally likely in every decade.
fn logarithmic(least: f64, most: f64, rng: &mut ChaCha8Rng) -> f64 {
    least * (most / least).powf(rng.random())
}
