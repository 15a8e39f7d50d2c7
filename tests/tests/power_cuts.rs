//! The power is cut at random instants while the image in the emulator writes to its memory, 200 times: none leaves a board without
//! a valid calibration, old or new.
//!
//! To end the emulator is to cut its power: its flash is a file, written word by word, and the word under way stays torn.
//!
//! | lives | what is under way when the power fails |
//! |---|---|
//! | 3 × 50 | stores and rollbacks; in every other life a sector is so full that the first of them erases one |
//! | 44 | a trial's start, with its erase, and the record of one that was stopped |
//! | 6 | the first checkpoint of a trial that runs |
//!
//! Several boards live at the same time: they wait most of it.
#![cfg(unix)]

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ftcal::link::client::Client;
use ftcal::link::error::ClientError;
use ftcal::link::serial::SerialTransport;
use ftcal::simulator::bench::Bench;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::flash::{FlashPace, SimulatedFlash};
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::tunnel::{Pace, TunnelledConverter};
use ftcal_firmware::storage::items::StoredCalibration;
use ftcal_firmware::storage::layout::SECTOR;
use ftcal_firmware::storage::memory::Memory;
use ftcal_shared::units::{DataRate, DeviceTime, Dof, Gain};
use ftcal_shared::wire::{CalibrationUpload, GageList, KeptCalibration, Resumption, TrialPhase};
use rand::{Rng, RngExt};

use ftcal_tests::random;

/// Boards that store, and lives of each.
const STORING: u64 = 3;
const STORING_LIVES: u32 = 50;
/// Lives of boards whose trial is stopped, and of boards whose trial runs.
const STOPPED_LIVES: u32 = 44;
const RUNNING_LIVES: u32 = 6;

/// How long the board writes at most before the power is cut: twice what a store and a rollback take.
const LONGEST_LIFE: Duration = Duration::from_millis(150);

/// How long samples are taken before a trial is stopped.
const SHORT_TRIAL: Duration = Duration::from_millis(200);
/// How long a record takes, with a margin.
const LONGEST_RECORD: Duration = Duration::from_millis(500);
/// When the first checkpoint of a running trial begins.
const FIRST_CHECKPOINT: Duration = Duration::from_secs(10);

/// How long the board may take to read its memory after a start, and to mend it.
const PATIENCE: Duration = Duration::from_secs(20);

fn image() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/images/ftcal-emulated.elf")
}

/// A calibration that no other number gives.
fn calibration(number: u32) -> CalibrationUpload {
    let bias_counts = GageList::from_slice(&[f64::from(number); 8]).unwrap();
    let matrix = (0..48_u8).map(|element| f32::from(element) / 16.0).collect();
    let mut upload = CalibrationUpload { dof: Dof::SpatialForceTorque, bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    upload
}

/// What may be current: `before` or `after` what was under way, the same where nothing was.
#[derive(Clone, Copy, Debug)]
struct Candidates {
    before: u32,
    after: u32,
}

/// Stores and rolls back until the line breaks, and keeps track of what may be current.
fn write_until_cut(
    mut client: Client<SerialTransport>,
    first: u32,
    candidates: &Mutex<Candidates>,
) -> ClientError {
    let expect = |after: u32| {
        let mut candidates = candidates.lock().unwrap_or_else(PoisonError::into_inner);
        // What is done is done: from now on this, or what comes next.
        candidates.before = candidates.after;
        candidates.after = after;
    };
    for number in first.. {
        let new = calibration(number);
        let steps = client
            .upload_calibration(&new)
            .inspect(|()| expect(new.identity))
            .and_then(|()| client.store_calibration())
            .and_then(|kept| {
                expect(kept.previous.unwrap_or(new.identity));
                client.roll_back()
            });
        match steps {
            Ok(in_use) => expect(in_use.identity),
            Err(error) => return error,
        }
    }
    unreachable!("numbers do not end before the power does")
}

/// A flash whose next store has to erase a sector, in which the first of two calibrations is current.
fn about_to_erase(path: &Path) -> Vec<u8> {
    let stored = |number| StoredCalibration { upload: calibration(number), gain: Gain::default() };
    let heads = |content: &[u8]| [2, 3].map(|sector| content[(sector * SECTOR) as usize..][..512].to_vec());
    let mut memory = Memory::new(SimulatedFlash::in_file(path).unwrap());
    memory.store_calibration(&stored(1)).unwrap();
    loop {
        for number in [2, 1] {
            let before = fs::read(path).unwrap();
            memory.store_calibration(&stored(number)).unwrap();
            if number == 2 && heads(&before) != heads(&fs::read(path).unwrap()) {
                return before;
            }
        }
    }
}

/// A converter that converts nothing.
struct Silent {
    now_micros: u64,
}

impl TunnelledConverter for Silent {
    fn exchange(&mut self, _from_board: &[u8], to_board: &mut [u8]) {
        to_board.fill(0);
    }

    fn next_conversion(&mut self) -> bool {
        self.now_micros += 10_000;
        false
    }

    fn now(&self) -> DeviceTime {
        DeviceTime::from_micros(self.now_micros)
    }
}

fn start(flash: &Path, converter: impl TunnelledConverter + Send + 'static) -> Emulator {
    let flash = SimulatedFlash::in_file(flash).unwrap().at_pace(FlashPace::Slow);
    Emulator::start_with_flash(&image(), converter, flash, Pace::RealTime).unwrap()
}

/// A load that is being turned.
fn turned() -> SharedBench {
    let scenario = Scenario::new(ScenarioKind::Wrist, 1).unwrap();
    let mut bench = Bench::new(scenario.sensor, 1);
    bench.hang(scenario.trials[0].load);
    bench.turn();
    SharedBench::new(bench)
}

fn connect(emulator: &Emulator) -> Client<SerialTransport> {
    Client::connect(SerialTransport::open(emulator.link().to_str().unwrap()).unwrap()).unwrap()
}

/// What the board keeps and uses, once it has read its memory.
fn kept(client: &mut Client<SerialTransport>) -> (KeptCalibration, Option<CalibrationUpload>) {
    let begin = Instant::now();
    loop {
        let status = client.status().unwrap();
        if status.kept.current != KeptCalibration::Unread {
            return (status.kept.current, client.read_calibration().unwrap());
        }
        assert!(begin.elapsed() < PATIENCE, "the memory is not read");
        client.wait(Duration::from_millis(5)).unwrap();
    }
}

/// The power fails while a board stores and rolls back.
fn store_through_cuts(seed: u64) {
    let mut rng = random(seed);
    let folder = tempfile::tempdir().unwrap();
    let full = about_to_erase(&folder.path().join("full"));
    let file = folder.path().join("flash");
    let current = calibration(1).identity;
    let mut may_be = Candidates { before: current, after: current };
    fs::write(&file, &full).unwrap();
    for cut in 0..STORING_LIVES {
        let emulator = start(&file, Silent { now_micros: 0 });
        let mut client = connect(&emulator);
        let (found, used) = kept(&mut client);
        let KeptCalibration::Calibration(identity) = found else {
            panic!("cut {cut}: {found:?}, {may_be:x?}")
        };
        assert!([may_be.before, may_be.after].contains(&identity), "cut {cut}: {identity:x}, {may_be:x?}");
        let used = used.unwrap();
        assert_eq!((used.identity, used.identity_of_numbers()), (identity, identity), "cut {cut}");

        let candidates = Arc::new(Mutex::new(Candidates { before: identity, after: identity }));
        let told = Arc::clone(&candidates);
        let first = 10 + 1000 * cut + rng.next_u32() % 1000;
        let writer = thread::spawn(move || write_until_cut(client, first, &told));
        thread::sleep(rng.random_range(Duration::ZERO..LONGEST_LIFE));
        drop(emulator);
        let error = writer.join().unwrap();
        assert!(matches!(error, ClientError::Link(_)), "cut {cut}: {error}");
        may_be = *candidates.lock().unwrap_or_else(PoisonError::into_inner);
        if cut % 2 == 1 {
            fs::write(&file, &full).unwrap();
            may_be = Candidates { before: current, after: current };
        }
    }
}

/// The power fails while a board starts trials, takes samples, and keeps what it has.
fn try_through_cuts(seed: u64, lives: u32, is_stopped: bool) {
    let mut rng = random(seed);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flash");
    let stored = StoredCalibration { upload: calibration(1), gain: Gain::default() };
    Memory::new(SimulatedFlash::in_file(&file).unwrap()).store_calibration(&stored).unwrap();
    // Samples of the last trial that was found whole.
    let mut last = 0;
    let mut resumed = 0;
    for cut in 0..lives {
        let emulator = start(&file, turned());
        let mut client = connect(&emulator);
        let (found, _) = kept(&mut client);
        assert_eq!(found, KeptCalibration::Calibration(stored.upload.identity), "cut {cut}");
        let trial = client.trial_status().unwrap();
        match trial.resumption {
            Resumption::None => assert_eq!(cut, 0),
            Resumption::Lost => assert_eq!(trial.phase, TrialPhase::None),
            Resumption::Resumed => {
                resumed += 1;
                assert!(trial.used > 0 && trial.checkpointed == trial.used, "cut {cut}: {trial:?}");
                let is_last = trial.used == last;
                assert!(is_last || trial.used <= trial.offered, "cut {cut}: {trial:?}");
                last = trial.used;
                if trial.phase == TrialPhase::Running {
                    client.stop_trial().unwrap();
                }
            }
        }
        client.configure_adc(DataRate::Hz250, Gain::default()).unwrap();
        client.start_trial(3).unwrap();
        let begin = Instant::now();
        if is_stopped {
            client.wait(SHORT_TRIAL).unwrap();
            client.stop_trial().unwrap();
        }
        let begun = if is_stopped { begin.elapsed() } else { FIRST_CHECKPOINT };
        let life = begun + rng.random_range(Duration::ZERO..LONGEST_RECORD);
        thread::sleep(life.saturating_sub(begin.elapsed()));
        drop(emulator);
    }
    assert!(resumed > lives / 4, "{resumed} of {lives}");
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn no_power_cut_leaves_a_board_without_a_valid_calibration() {
    thread::scope(|scope| {
        for seed in 0..STORING {
            scope.spawn(move || store_through_cuts(seed));
        }
        scope.spawn(|| try_through_cuts(STORING, STOPPED_LIVES, true));
        scope.spawn(|| try_through_cuts(STORING + 1, RUNNING_LIVES, false));
    });
}
