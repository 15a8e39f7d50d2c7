//! A simulated board with somebody before it, who presses its button and looks at its light.

use std::time::Duration;

use ftcal::link::client::Client;
use ftcal::link::frame::{Frame, Measured};
use ftcal::link::transport::Transport;
use ftcal::simulator::bench::Load;
use ftcal::simulator::board::SimulatedBoard;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::flash::SimulatedFlash;
use ftcal::simulator::operator::turn;
use ftcal::simulator::panel::SharedPanel;
use ftcal::simulator::scenario::Scenario;
use ftcal::simulator::sensor::SoftwareSensor;
use ftcal_shared::wire::{FieldOutcome, FieldPhase, FieldRefusal, StreamKind};
use ftcal_tests::truth::true_calibration;
use nalgebra::{UnitVector3, Vector3};

/// A pattern of the light has sixteen slots of this length; see `firmware/src/field/light.rs`.
const SLOT_MICROS: u128 = 1 << 17;

/// How long a trial may take, and how long what comes after it.
pub(super) const PATIENCE: Duration = Duration::from_mins(10);

/// The light in one round: how often it goes on, and in how many slots it is on.
pub(super) type Seen = (usize, usize);
pub(super) const DARK: Seen = (0, 0);
pub(super) const WORKING: Seen = (1, 8);
pub(super) const RENEWED: Seen = (0, 16);
pub(super) const CONFIRMED: Seen = (2, 14);
pub(super) const REFUSED: Seen = (8, 8);

/// A board with somebody before it.
pub(super) struct Rig {
    pub(super) client: Client<SimulatedBoard>,
    pub(super) panel: SharedPanel,
    pub(super) bench: SharedBench,
}

/// A sensor whose gage answers so many times as much, and whose bias has moved by this many counts.
pub(super) fn drifted(sensor: &SoftwareSensor, gage: usize, gain: f64, bias_counts: f64) -> SoftwareSensor {
    let (mut shape, mut bias) = (sensor.shape().clone(), sensor.bias_counts().clone());
    shape.column_mut(gage).scale_mut(gain);
    bias[gage] += bias_counts;
    SoftwareSensor::new(sensor.dof(), shape, bias, sensor.noise_counts().clone()).expect("sizes fit")
}

impl Rig {
    pub(super) fn new(sensor: &SoftwareSensor, flash: SimulatedFlash, load: Load, seed: u64) -> Self {
        let board = SimulatedBoard::with_flash(sensor.clone(), seed, flash).expect("sizes fit");
        let (panel, bench) = (board.panel(), board.bench());
        bench.with(|bench| {
            bench.hang(load);
            turn(bench);
        });
        let mut client = Client::connect(board).expect("answers");
        client.wait_for_converter().expect("the converter starts");
        let mut rig = Self { client, panel, bench };
        // The button is to be seen released first.
        rig.wait(Duration::from_millis(100));
        rig
    }

    /// A sensor that knows its truth, exchanged for another one.
    pub(super) fn exchanged(scenario: &Scenario, other: &SoftwareSensor, seed: u64) -> Self {
        let (flash, load) = (SimulatedFlash::default(), scenario.trials[0].load);
        let mut before = Self::new(&scenario.sensor, flash.clone(), load, seed);
        before.client.upload_calibration(&true_calibration(&scenario.sensor)).expect("answers");
        before.client.store_calibration().expect("stores");
        Self::new(other, flash, load, seed)
    }

    pub(super) fn wait(&mut self, time: Duration) {
        self.client.wait(time).expect("the line is sound");
    }

    pub(super) fn press(&mut self, time: Duration) {
        self.panel.press(true);
        self.wait(time);
        self.panel.press(false);
        self.wait(Duration::from_millis(100));
    }

    pub(super) fn hold_down(&mut self) {
        self.press(Duration::from_millis(2500));
    }

    pub(super) fn tap(&mut self) {
        self.press(Duration::from_millis(300));
    }

    /// The light over one round.
    pub(super) fn light(&mut self) -> Seen {
        // In the middle of each slot.
        let seen: Vec<bool> = (0..16)
            .map(|_| {
                let into_slot = (self.client.line().elapsed().as_micros() + SLOT_MICROS / 2) % SLOT_MICROS;
                let rest = u64::try_from(SLOT_MICROS - into_slot).expect("small");
                self.wait(Duration::from_micros(rest));
                self.panel.light()
            })
            .collect();
        let edges = (0..16).filter(|&slot| seen[slot] && !seen[(slot + 15) % 16]).count();
        let on = seen.iter().filter(|&&is_on| is_on).count();
        (edges, on)
    }

    pub(super) fn phase(&mut self) -> FieldPhase {
        self.client.field().expect("answers").phase
    }

    /// What the calibration ends with, and how often the light flashed while the trial ran, at most.
    pub(super) fn outcome(&mut self) -> (FieldOutcome, usize) {
        let (end, mut most) = (self.client.line().elapsed() + PATIENCE, 0);
        while self.client.line().elapsed() < end {
            let before = self.phase();
            let (flashes, _) = self.light();
            match (before, self.phase()) {
                (FieldPhase::Running { quarters: before }, FieldPhase::Running { quarters: after })
                    if before == after =>
                {
                    assert_eq!(flashes, usize::from(before) + 1);
                    most = most.max(flashes);
                }
                (_, FieldPhase::Idle) => {
                    let report = self.client.field().expect("answers");
                    return (report.last.expect("an outcome"), most);
                }
                _ => {}
            }
        }
        panic!("no outcome")
    }

    pub(super) fn refusal(&mut self) -> FieldRefusal {
        match self.outcome() {
            (FieldOutcome::Refused(refusal), _) => {
                assert_eq!(self.light(), REFUSED);
                refusal
            }
            other => panic!("{other:?}"),
        }
    }

    /// The root mean square error of a known load in all directions, relative to it, as streamed wrenches tell it.
    pub(super) fn error(&mut self, load: Load) -> f64 {
        let directions = [Vector3::x(), Vector3::y(), Vector3::z(), Vector3::new(1.0, 1.0, 1.0)];
        let mut squares = 0.0;
        for direction in directions.into_iter().flat_map(|direction| [direction, -direction]) {
            self.bench.with(|bench| {
                bench.hang(load);
                bench.hold(UnitVector3::new_normalize(direction));
            });
            self.wait(Duration::from_millis(50));
            self.client.stream(StreamKind::Wrench).expect("answers");
            let (mut sum, mut count) = (Vector3::zeros(), 0);
            while count < 200 {
                let frame = self.client.next_frame(Duration::from_secs(1)).expect("the line is sound");
                let Some(Frame::Wrench(sample)) = frame else { continue };
                if let Measured::Valid(wrench) = sample.at_any_age() {
                    let force = wrench.components();
                    sum += Vector3::from_fn(|axis, _| f64::from(force[axis]));
                    count += 1;
                }
            }
            self.client.stream(StreamKind::Off).expect("answers");
            let truth = self.bench.with(|bench| bench.true_wrench().force_newton);
            squares += (sum / f64::from(count) - truth).norm_squared() / truth.norm_squared();
        }
        (squares / 8.0).sqrt()
    }
}
