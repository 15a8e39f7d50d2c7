//! The firmware's own sensor on the simulated bench, sample by sample in virtual time, so that each frame is compared with the truth
//! of that very instant.

use embedded_hal::delay::DelayNs;
use ftcal::simulator::bench::{Bench, Load};
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::operator::turn;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::sensor::SoftwareSensor;
use ftcal_firmware::polled::PolledSensor;
use ftcal_firmware::sensor::{LinkCounters, Reaction};
use ftcal_firmware::storage::job::{StoreJob, Stored};
use ftcal_firmware::stream::{Measurement, Moment};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::{DataRate, Gain};
use ftcal_shared::wire::health::StatusWord;
use ftcal_shared::wire::{
    CalibrationUpload, ClockSource, HealthReport, HealthRequest, HealthResponse, Request, Response,
    StreamKind,
};
use ftcal_tests::truth::{true_calibration, true_matrix};
use nalgebra::{DMatrix, DVector};

/// Between two ticks, as on the board.
const TICK_MICROS: u64 = 2_000;

/// What the firmware allows beyond noise: see `firmware/src/health/parity_monitor.rs`.
const TOLERANCE: f64 = 8192.0;
const MODEL_TOLERANCE: f64 = 4e-3;

/// A sensor with the truth under it.
pub(super) struct Rig<const GAGES: usize, const HIGHER: usize> {
    pub(super) bench: SharedBench,
    pub(super) polled: PolledSensor<SharedBench, Box<Bins<GAGES, HIGHER>>, GAGES, HIGHER>,
    pub(super) next_tick: u64,
    pub(super) truth: SoftwareSensor,
}

/// What one conversion period brought.
pub(super) struct Step {
    /// Everything that was streamed, and the wrench at that moment.
    pub(super) measurements: Vec<Measurement>,
    pub(super) truth: DVector<f64>,
    pub(super) word: StatusWord,
}

struct Wait<'a>(&'a SharedBench);

impl DelayNs for Wait<'_> {
    fn delay_ns(&mut self, nanoseconds: u32) {
        self.0.with(|bench| {
            let end = bench.now().as_micros() + u64::from(nanoseconds).div_ceil(1000);
            while bench.now().as_micros() < end {
                bench.next_conversion();
            }
        });
    }
}

impl<const GAGES: usize, const HIGHER: usize> Rig<GAGES, HIGHER> {
    /// A sensor that knows its own truth as calibration, streams wrenches at this rate, and has learned its noise with this load
    /// turning on it.
    pub(super) fn new(truth: &SoftwareSensor, load: Load, seed: u64, rate: DataRate) -> Self {
        let bench = SharedBench::new(Bench::new(truth.clone(), seed));
        bench.with(|bench| {
            bench.hang(load);
            turn(bench);
        });
        let polled = PolledSensor::new(bench.clone(), Box::new(Bins::new()), ClockSource::Simulated);
        let mut rig = Self { bench, polled, next_tick: 0, truth: truth.clone() };
        rig.ask(Request::ConfigureAdc(rate, Gain::X128));
        rig.ask(Request::Stream(StreamKind::Wrench));
        rig.run(0.05);
        rig.ask(Request::UploadCalibration(rig.upload()));
        rig.run(0.7);
        assert_eq!(rig.polled.sensor.status_word(), StatusWord::NONE, "well");
        rig.health(HealthRequest::ClearLatched);
        rig
    }

    pub(super) fn of(scenario: &Scenario, seed: u64, rate: DataRate) -> Self {
        Self::new(&scenario.sensor, scenario.trials[0].load, seed, rate)
    }

    pub(super) fn upload(&self) -> CalibrationUpload {
        true_calibration(&self.truth)
    }

    pub(super) fn ask(&mut self, request: Request) -> Response {
        let now = self.bench.with(|bench| bench.now());
        match self.polled.sensor.answer(request, now, LinkCounters::default()) {
            Reaction::Respond(response) => response,
            // A trial without checkpoints.
            Reaction::Store(StoreJob::PrepareTrial { rank, .. }) => {
                self.polled.sensor.finish_storing(Stored::Prepared { rank })
            }
            Reaction::Solve(_) | Reaction::Store(_) | Reaction::Diagnose => {
                panic!("nothing of this is asked here")
            }
        }
    }

    pub(super) fn health(&mut self, request: HealthRequest) -> HealthReport {
        match self.ask(Request::Health(request)) {
            Response::Health(HealthResponse::Report(report)) => report,
            other => panic!("{other:?}"),
        }
    }

    pub(super) fn now_micros(&self) -> u64 {
        self.bench.with(|bench| bench.now().as_micros())
    }

    /// Lives through one conversion period.
    pub(super) fn step(&mut self) -> Step {
        let mut frames = Vec::new();
        if self.now_micros() >= self.next_tick {
            let now = self.bench.with(|bench| bench.now());
            self.next_tick = now.as_micros() + TICK_MICROS;
            frames.extend(self.polled.tick(now, &mut Wait(&self.bench)));
        }
        let announced = self.bench.with(Bench::next_conversion);
        let (now, wrench) = self.bench.with(|bench| (bench.now(), bench.true_wrench()));
        if announced {
            frames.extend(self.polled.on_data_ready(now, now));
        }
        let measurements = frames
            .into_iter()
            .map(|frame| match frame {
                Moment::Wrench(moment) => moment.measurement,
                Moment::Silence(moment) => Measurement::Invalid(moment.cause),
                Moment::Codes(_) => panic!("wrenches were asked for"),
            })
            .collect();
        Step {
            measurements,
            truth: wrench.components(self.truth.dof()),
            word: self.polled.sensor.status_word(),
        }
    }

    pub(super) fn run(&mut self, seconds: f64) {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a few seconds")]
        let end = self.now_micros() + (seconds * 1e6) as u64;
        while self.now_micros() < end {
            self.step();
        }
    }

    /// The truth as a calibration matrix.
    pub(super) fn matrix(&self) -> DMatrix<f64> {
        true_matrix(&self.truth)
    }

    /// Standard deviation of each component from the gages' noise.
    pub(super) fn noise(&self) -> DVector<f64> {
        let variances = self.truth.noise_counts().map(|noise| noise * noise);
        let matrix = self.matrix();
        DVector::from_fn(matrix.nrows(), |row, _| {
            matrix.row(row).iter().zip(variances.iter()).map(|(c, v)| c * c * v).sum::<f64>().sqrt()
        })
    }

    /// I − SᵀC.
    pub(super) fn projector(&self) -> DMatrix<f64> {
        DMatrix::identity(GAGES, GAGES) - self.truth.shape().transpose() * self.matrix()
    }

    /// By how much gage k may be off at most in a sample that is called valid: what is allowed of its parity, and six standard
    /// deviations of the noise in it.
    pub(super) fn largest_hidden(&self, gage: usize, truth: &DVector<f64>) -> f64 {
        let projector = self.projector();
        let noise: f64 = (0..GAGES).map(|k| projector[(k, k)] * self.truth.noise_counts()[k].powi(2)).sum();
        // A gage that is off counts in the signal, too.
        let signal = self.truth.shape().tr_mul(truth).norm() * 1.5;
        let allowed = 36.0 * 1.3 * noise + TOLERANCE.powi(2) + (MODEL_TOLERANCE * signal).powi(2);
        (allowed.sqrt() + 6.0 * noise.sqrt()) / projector[(gage, gage)].sqrt()
    }
}

/// Each component must be within what is allowed of the truth.
pub(super) fn assert_near(wrench: &[f32], truth: &DVector<f64>, allowed: &DVector<f64>, what: &str) {
    for (axis, allowed) in allowed.iter().enumerate() {
        let error = f64::from(wrench[axis]) - truth[axis];
        assert!(error.abs() < *allowed, "{what}: component {axis} is off by {error} of {allowed}");
    }
}

/// The scenario of this kind and seed.
pub(super) fn scenario(kind: ScenarioKind, seed: u64) -> Scenario {
    Scenario::new(kind, seed).expect("sizes fit")
}
