//! Shape from motion on the bench: turn the sensor at random under one mass, let it solve the trial itself, then hold
//! it at a few known directions (paper, figure 2).

use std::io::Write;
use std::time::Duration;

use ftcal_shared::units::{AdcCode, Dof, SampleIndex};
use ftcal_shared::wire::{Solution, StreamKind, TrialStatus};
use nalgebra::{DMatrix, DVector, Rotation3, Unit, UnitVector3, Vector3};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::{DemoError, GAIN, Stage};
use crate::calibration::consistency::ARM_ACCURACY_M;
use crate::calibration::known_load::{KnownLoad, LoadCase, average};
use crate::calibration::motion;
use crate::calibration::samples::SampleCounts;
use crate::calibration::trial::{self, Gating, TrialShape};
use crate::calibration::turning::{Turned, swept};
use crate::calibration::{CalibrationRefusal, SolvedTrial};
use crate::link::client::Client;
use crate::link::error::{ClientError, LinkError};
use crate::link::frame::Frame;
use crate::recording::Recording;
use crate::session_file;
use crate::simulator::bench::{Load, STANDARD_GRAVITY};
use crate::simulator::board::SimulatedBoard;
use crate::simulator::motion::Turning;
use crate::simulator::scenario::{Scenario, ScenarioTrial};

/// Gravity on the bench, m/s².
pub const GRAVITY: f64 = STANDARD_GRAVITY;

/// Samples of one trial: three minutes at 1000 samples/s.
const TRIAL_SAMPLES: usize = 180_000;

/// Samples of one rest.
pub const REST_SAMPLES: usize = 500;

/// Time for the sensor to come to rest before a known load is read.
const SETTLING: Duration = Duration::from_millis(50);

/// The longest wait for a sample.
const SAMPLE_WAIT: Duration = Duration::from_secs(1);

/// One trial with all that was recorded of it.
pub struct AcquiredTrial {
    /// The trial as the sensor solved it.
    pub solved: SolvedTrial,
    /// The codes that the sensor solved it from.
    pub recording: Recording,
    /// The rests at known loads.
    pub rests: Vec<Recording>,
}

/// Goes through the scenario's trials.
///
/// # Errors
///
/// [`DemoError`]; a refused trial is a [`ClientError`].
pub fn acquire(
    stage: &mut Stage,
    scenario: &Scenario,
    progress: &mut dyn Write,
) -> Result<Vec<AcquiredTrial>, DemoError> {
    let rank = scenario.sensor.dof().trial_rank();
    let mut acquired = Vec::with_capacity(scenario.trials.len());
    for (index, trial) in scenario.trials.iter().enumerate() {
        let arm = trial.load.arm_m;
        let place = if scenario.sensor.dof().has_torque() {
            format!(" at ({:.3}, {:.3}, {:.3}) m", arm.x, arm.y, arm.z)
        } else {
            String::new()
        };
        writeln!(
            progress,
            "Trial {} of {}: {:.4} kg{place}, turned by hand for three minutes …",
            index + 1,
            scenario.trials.len(),
            trial.load.mass_kg,
        )?;
        let (recording, solution, status) = turn_and_solve(stage, trial, rank)?;
        // The sensor sends its answer alone; how certain that is follows from the same codes.
        let on_host = trial::solve(&recording, rank, Gating::Once).map_err(refused(index))?;
        let of_host = on_host.shape_counts_per_load.clone();
        let shape = from_sensor(&solution, &status, on_host);
        let difference = relative_difference(&shape.shape_counts_per_load, &of_host);
        writeln!(
            progress,
            "  solved on the sensor from {} samples, noise {:.0} counts; the host, from the same codes: {}.",
            solution.samples,
            solution.noise_counts.unwrap_or(0.0),
            if difference == 0.0 {
                "the same to the last bit".to_owned()
            } else {
                format!("the same to {difference:.0e}")
            },
        )?;
        let motion = motion::recover(&recording, &shape).map_err(refused(index))?;
        let turned = trial.turning.map(|turning| Turned { claimed: claimed(turning), swept: swept(&motion) });

        let mut rests = Vec::with_capacity(trial.known_directions.len());
        let mut known_loads = Vec::with_capacity(trial.known_directions.len());
        for (load, &direction) in trial.known_directions.iter().enumerate() {
            let rest = hold_and_record(stage, trial.load, direction)?;
            known_loads.push(KnownLoad {
                direction: DVector::from_iterator(rank, direction.iter().copied().take(rank)),
                accuracy_rad: stage.workmanship.direction_rad,
                rest: average(&rest).ok_or(CalibrationRefusal::KnownLoadSaturated { trial: index, load })?,
            });
            rests.push(rest);
        }
        let directions = if rests.len() == 1 { "direction" } else { "directions" };
        writeln!(progress, "  held at {} known {directions}.", rests.len())?;
        let case = LoadCase {
            name: recording_name(index),
            mass_kg: trial.load.mass_kg,
            arm_m: arm_components(scenario.sensor.dof(), &trial.load),
            arm_accuracy_m: ARM_ACCURACY_M,
            mass_accuracy_kg: stage.workmanship.force_newton / GRAVITY,
            known_loads,
        };
        acquired.push(AcquiredTrial { solved: SolvedTrial { case, shape, turned }, recording, rests });
    }
    Ok(acquired)
}

/// Runs one trial on the sensor, streaming its codes alongside: the very samples that the sensor summed up.
fn turn_and_solve(
    stage: &mut Stage,
    trial: &ScenarioTrial,
    rank: usize,
) -> Result<(Recording, Solution, TrialStatus), DemoError> {
    let load = stage.imperfect_load(trial.load);
    stage.bench.with(|bench| {
        bench.hang(load);
        match trial.turning {
            Some(turning) => {
                bench.hold(-Vector3::y_axis());
                bench.turn_in_plane(turning);
            }
            None => bench.turn(),
        }
    });
    stage.client.stream(StreamKind::Codes)?;
    #[expect(clippy::cast_possible_truncation, reason = "rank 2 or 3")]
    stage.client.start_trial(rank as u8)?;
    let mut samples = collect(&mut stage.client, TRIAL_SAMPLES)?;
    let status = stage.client.stop_trial()?;
    // What was on the line when the trial stopped.
    while samples.last().is_some_and(|last| last.index.since(status.first) + 1 < status.offered) {
        samples.append(&mut collect(&mut stage.client, 1)?);
    }
    stage.client.stream(StreamKind::Off)?;
    samples.retain(|sample| sample.index.since(status.first) < status.offered);
    let solution = stage.client.solve_trial()?;
    // What the solution leaves out is known only now.
    Ok((recording_of(&samples), solution, stage.client.trial_status()?))
}

/// Holds the load as well as can be along this direction of the sensor frame, and records a rest.
///
/// # Errors
///
/// [`DemoError`].
pub fn hold_and_record(
    stage: &mut Stage,
    load: Load,
    direction: UnitVector3<f64>,
) -> Result<Recording, DemoError> {
    let planar = stage.bench.with(|bench| bench.sensor().dof().trial_rank()) == 2;
    let tilted = tilted(direction, stage.workmanship.direction_rad, planar, &mut stage.chance);
    let load = stage.imperfect_load(load);
    stage.hold_exactly(load, tilted)?;
    stage.record(REST_SAMPLES)
}

impl Stage {
    /// Brings the sensor to rest under exactly this load.
    ///
    /// # Errors
    ///
    /// [`DemoError`].
    pub fn hold_exactly(&mut self, load: Load, direction: UnitVector3<f64>) -> Result<(), DemoError> {
        self.bench.with(|bench| {
            bench.hang(load);
            bench.hold(direction);
        });
        Ok(self.client.wait(SETTLING)?)
    }

    /// Records so many samples.
    ///
    /// # Errors
    ///
    /// [`DemoError`].
    pub fn record(&mut self, samples: usize) -> Result<Recording, DemoError> {
        self.client.stream(StreamKind::Codes)?;
        let samples = collect(&mut self.client, samples)?;
        self.client.stream(StreamKind::Off)?;
        Ok(recording_of(&samples))
    }

    /// The load as it really is, when somebody says that it is `stated`.
    fn imperfect_load(&mut self, stated: Load) -> Load {
        let error: f64 = StandardNormal.sample(&mut self.chance);
        let mass_kg = stated.mass_kg + error * self.workmanship.force_newton / GRAVITY;
        Load { mass_kg, ..stated }
    }
}

/// The direction as it really is, when somebody says that it is `stated`: off by this standard deviation in each of the
/// two ways it can be off, or in the one way that a plane leaves.
fn tilted(
    stated: UnitVector3<f64>,
    deviation_rad: f64,
    planar: bool,
    chance: &mut ChaCha8Rng,
) -> UnitVector3<f64> {
    let mut turn =
        Vector3::from_fn(|_, _| deviation_rad * Distribution::<f64>::sample(&StandardNormal, chance));
    if planar {
        turn = Vector3::new(0.0, 0.0, turn.z);
    }
    Unit::new_normalize(Rotation3::new(turn) * stated.into_inner())
}

/// One streamed sample.
struct Sample {
    index: SampleIndex,
    time_s: f64,
    codes: Vec<AdcCode>,
}

fn collect(client: &mut Client<SimulatedBoard>, samples: usize) -> Result<Vec<Sample>, ClientError> {
    let mut collected = Vec::with_capacity(samples);
    while collected.len() < samples {
        if let Frame::Codes(frame) = next_frame(client)? {
            collected.push(Sample {
                index: frame.index,
                time_s: frame.time.as_seconds(),
                codes: frame.codes.to_vec(),
            });
        }
    }
    Ok(collected)
}

/// The next sample of a stream that is on.
///
/// # Errors
///
/// [`LinkError::Silence`] where none comes.
pub fn next_frame(client: &mut Client<SimulatedBoard>) -> Result<Frame, ClientError> {
    let silence = LinkError::Silence { seconds: SAMPLE_WAIT.as_secs_f64() };
    client.next_frame(SAMPLE_WAIT)?.ok_or_else(|| silence.into())
}

fn recording_of(samples: &[Sample]) -> Recording {
    let gages = samples.first().map_or(0, |sample| sample.codes.len());
    let times = samples.iter().map(|sample| sample.time_s).collect();
    let codes = samples.iter().flat_map(|sample| sample.codes.iter().copied()).collect();
    Recording::from_codes(gages, times, codes).at_gain(Some(GAIN))
}

/// The sensor's solution as the host's calibration takes it. Which samples took part, and how certain the answer is, is what
/// the host found: the sensor does the same and tells the answer alone.
fn from_sensor(solution: &Solution, status: &TrialStatus, on_host: TrialShape) -> TrialShape {
    let gages = solution.bias_counts.len();
    TrialShape {
        samples: SampleCounts::on_the_sensor(status, solution),
        eigenvalues: DVector::from_column_slice(&solution.eigenvalues),
        noise_counts: solution.noise_counts,
        bias_counts: DVector::from_column_slice(&solution.bias_counts),
        shape_counts_per_load: DMatrix::from_row_slice(
            usize::from(solution.rank),
            gages,
            &solution.shape_counts_per_load,
        ),
        ..on_host
    }
}

fn relative_difference(left: &DMatrix<f64>, right: &DMatrix<f64>) -> f64 {
    (left - right).norm() / right.norm()
}

fn refused(trial: usize) -> impl FnOnce(ftcal_shared::refusal::Refusal) -> CalibrationRefusal {
    move |refusal| CalibrationRefusal::Trial { trial, refusal }
}

/// The arm as a session states it: as many components as the trial has directions, none for a force sensor.
pub fn arm_components(dof: Dof, load: &Load) -> DVector<f64> {
    let components = if dof.has_torque() { dof.trial_rank() } else { 0 };
    DVector::from_iterator(components, load.arm_m.iter().copied().take(components))
}

const fn claimed(turning: Turning) -> session_file::Turning {
    match turning {
        Turning::Counterclockwise => session_file::Turning::Counterclockwise,
        Turning::Clockwise => session_file::Turning::Clockwise,
    }
}

fn recording_name(trial: usize) -> String {
    format!("trial{}.csv", trial + 1)
}
