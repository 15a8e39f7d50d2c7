//! The power is cut at random instants while the image in the emulator writes to its memory, 200 times with `tests/power_cuts`, and a
//! tenth as often with every `tests/run`: none leaves a board without a valid calibration, old or new.
//!
//! To end the emulator is to cut its power: its flash is a file, written word by word, and the word under way stays torn.
//!
//! | lives of 200 | what is under way when the power fails |
//! |---|---|
//! | 3 × 50 | stores and rollbacks; in every other life a sector is so full that the first of them erases one |
//! | 2 × 22 | a trial's start, with its erase, and the record of one that was stopped |
//! | 6 | the first checkpoint of a trial that runs |
//!
//! Several boards live at the same time: they wait most of it.
#![cfg(unix)]

use std::env;
use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

use ftcal::link::client::Client;
use ftcal::link::error::ClientError;
use ftcal::link::serial::SerialTransport;
use ftcal::simulator::bench::Bench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::flash::{FlashPace, SimulatedFlash};
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::tunnel::{Pace, TunnelledConverter};
use ftcal_firmware::storage::items::StoredCalibration;
use ftcal_firmware::storage::layout::SECTOR;
use ftcal_firmware::storage::memory::Memory;
use ftcal_shared::units::{DeviceTime, Dof, Gain};
use ftcal_shared::wire::{
    CalibrationOrigin, CalibrationUpload, GageList, KeptCalibration, Rejection, Resumption, TrialPhase,
    TrialStatus,
};
use rand::{Rng, RngExt};

use ftcal_tests::image;
use ftcal_tests::patience::{PATIENCE, connect, patiently};
use ftcal_tests::random;

/// Boards that store.
const STORING: u64 = 3;

/// How many lives each board has.
struct Lives {
    /// Of each that stores.
    storing: u32,
    /// Of each whose trial is stopped.
    stopped: u32,
    /// Of the one whose trial runs.
    running: u32,
}

/// 200 in all.
const ALL: Lives = Lives { storing: 50, stopped: 22, running: 6 };
/// A tenth of them.
const SOME: Lives = Lives { storing: 4, stopped: 3, running: 2 };

/// Asks for all of them.
const ALL_WANTED: &str = "FTCAL_ALL_POWER_CUTS";

/// When the power fails at the latest, in terms of how long it takes what is under way to end.
const LATEST_CUT: f64 = 1.5;

/// Samples that are taken before a trial is stopped.
const SHORT_TRIAL: u32 = 12;
/// When the first checkpoint of a running trial begins.
const FIRST_CHECKPOINT: Duration = Duration::from_secs(10);

/// A calibration that no other number gives.
fn calibration(number: u32) -> CalibrationUpload {
    let bias_counts = GageList::from_slice(&[f64::from(number); 8]).unwrap();
    let matrix = (0..48_u8).map(|element| f32::from(element) / 16.0).collect();
    let mut upload = CalibrationUpload {
        dof: Dof::SpatialForceTorque,
        gain: Gain::default(),
        bias_counts,
        matrix,
        identity: 0,
    };
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

/// The heads of the two sectors of items: they change with every erase.
fn heads(content: &[u8]) -> [&[u8]; 2] {
    [2, 3].map(|sector| &content[(sector * SECTOR) as usize..][..512])
}

/// A flash whose next store has to erase a sector, in which the first of two calibrations is current.
///
/// The map passes over the data of an item whose checksum is zero: such items fill the sector, and cost the emulated board no time
/// to read, which thousands of others would.
fn about_to_erase(folder: &Path) -> Vec<u8> {
    let (full, probe) = (folder.join("full"), folder.join("probe"));
    let stored =
        |number| StoredCalibration { upload: calibration(number), origin: CalibrationOrigin::Uploaded };
    let memory = |path: &Path| Memory::new(SimulatedFlash::in_file(path).unwrap());
    for number in [2, 1] {
        memory(&full).store_calibration(&stored(number)).unwrap();
    }
    let mut content = fs::read(&full).unwrap();
    let end = (3 * SECTOR) as usize - 4;
    let mut free = end - content[..end].iter().rev().take_while(|byte| **byte == 0xFF).count();
    free = free.next_multiple_of(4);
    while end - free > 320 {
        let length = u16::try_from((end - free - 300).min(60_000) / 4 * 4).unwrap();
        content[free..free + 4].fill(0);
        content[free + 4..free + 6].copy_from_slice(&length.to_le_bytes());
        content[free + 6..free + 8].copy_from_slice(&checksum_of_length(length).to_le_bytes());
        free += 8 + usize::from(length);
    }
    fs::write(&probe, &content).unwrap();
    memory(&probe).store_calibration(&stored(3)).unwrap();
    assert_ne!(heads(&content), heads(&fs::read(&probe).unwrap()), "nothing was erased");
    content
}

/// What the map keeps with the length of an item.
fn checksum_of_length(length: u16) -> u16 {
    let mut checksum = u16::MAX;
    for byte in length.to_le_bytes() {
        checksum ^= u16::from(byte);
        for _ in 0..8 {
            checksum = (checksum >> 1) ^ if checksum & 1 == 1 { 0x1A2E } else { 0 };
        }
    }
    (!checksum).min(0xFFFE)
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
    Emulator::start_with_flash(&image::path("ftcal-emulated.elf"), converter, flash, Pace::RealTime).unwrap()
}

/// A load that is being turned, before a converter that announces but a few conversions: the emulator takes milliseconds for each.
struct Sparse {
    bench: Bench,
}

impl Sparse {
    fn new() -> Self {
        let scenario = Scenario::new(ScenarioKind::Wrist, 1).unwrap();
        let mut bench = Bench::new(scenario.sensor, 1);
        bench.hang(scenario.trials[0].load);
        bench.turn();
        Self { bench }
    }
}

impl TunnelledConverter for Sparse {
    fn exchange(&mut self, from_board: &[u8], to_board: &mut [u8]) {
        self.bench.exchange(from_board, to_board);
    }

    fn next_conversion(&mut self) -> bool {
        let end = self.bench.now().as_micros() + 40_000;
        let mut announced = false;
        while self.bench.now().as_micros() < end {
            announced = self.bench.next_conversion();
        }
        announced
    }

    fn now(&self) -> DeviceTime {
        self.bench.now()
    }
}

/// Waits until the trial is as it should be.
fn wait_for_trial(client: &mut Client<SerialTransport>, expected: impl Fn(&TrialStatus) -> bool) {
    let begin = Instant::now();
    loop {
        let trial = patiently(|| client.trial_status());
        if expected(&trial) {
            return;
        }
        assert!(begin.elapsed() < PATIENCE, "{trial:?}");
        client.wait(Duration::from_millis(5)).unwrap();
    }
}

/// What the board keeps and uses, once it has read its memory.
fn kept(client: &mut Client<SerialTransport>) -> (KeptCalibration, Option<CalibrationUpload>) {
    let begin = Instant::now();
    loop {
        let status = patiently(|| client.status());
        if status.kept.current != KeptCalibration::Unread {
            return (status.kept.current, patiently(|| client.read_calibration()));
        }
        assert!(begin.elapsed() < PATIENCE, "the memory is not read");
        client.wait(Duration::from_millis(5)).unwrap();
    }
}

/// The power fails while a board stores and rolls back.
fn store_through_cuts(seed: u64, lives: u32) {
    let mut rng = random(seed);
    let folder = tempfile::tempdir().unwrap();
    let full = about_to_erase(folder.path());
    let file = folder.path().join("flash");
    let current = calibration(1).identity;
    let mut may_be = Candidates { before: current, after: current };
    let mut latest = Duration::ZERO;
    for cut in 0..lives {
        if cut % 2 == 0 {
            fs::write(&file, &full).unwrap();
            may_be = Candidates { before: current, after: current };
        }
        let emulator = start(&file, Silent { now_micros: 0 });
        let mut client = connect(&emulator);
        let (found, used) = kept(&mut client);
        let KeptCalibration::Calibration(identity) = found else {
            panic!("cut {cut}: {found:?}, {may_be:x?}")
        };
        assert!([may_be.before, may_be.after].contains(&identity), "cut {cut}: {identity:x}, {may_be:x?}");
        let used = used.unwrap();
        assert_eq!((used.identity, used.identity_of_numbers()), (identity, identity), "cut {cut}");

        let mut before = identity;
        if latest.is_zero() {
            // With an erase, a store, and what a rollback takes.
            let begin = Instant::now();
            patiently(|| client.store_calibration());
            patiently(|| client.upload_calibration(&calibration(2)));
            patiently(|| client.store_calibration());
            patiently(|| client.roll_back());
            latest = begin.elapsed().mul_f64(LATEST_CUT);
            // Whoever asks for a rollback a second time, because no answer came, has two of them.
            before = patiently(|| client.read_calibration()).unwrap().identity;
            assert!([identity, calibration(2).identity].contains(&before), "cut {cut}: {before:x}");
        }
        let candidates = Arc::new(Mutex::new(Candidates { before, after: before }));
        let told = Arc::clone(&candidates);
        let first = 10 + 1000 * cut + rng.next_u32() % 1000;
        let writer = thread::spawn(move || write_until_cut(client, first, &told));
        thread::sleep(rng.random_range(Duration::ZERO..latest));
        drop(emulator);
        let error = writer.join().unwrap();
        assert!(matches!(error, ClientError::Link(_)), "cut {cut}: {error}");
        may_be = *candidates.lock().unwrap_or_else(PoisonError::into_inner);
    }
}

/// The power fails while a board starts trials, takes samples, and keeps what it has.
fn try_through_cuts(seed: u64, lives: u32, is_stopped: bool) {
    let mut rng = random(seed);
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("flash");
    let stored = StoredCalibration { upload: calibration(1), origin: CalibrationOrigin::Uploaded };
    Memory::new(SimulatedFlash::in_file(&file).unwrap()).store_calibration(&stored).unwrap();
    let (mut resumed, mut latest) = (0, Duration::ZERO);
    for cut in 0..lives {
        let emulator = start(&file, Sparse::new());
        let mut client = connect(&emulator);
        let (found, _) = kept(&mut client);
        assert_eq!(found, KeptCalibration::Calibration(stored.upload.identity), "cut {cut}");
        let trial = patiently(|| client.trial_status());
        match trial.resumption {
            Resumption::None => assert_eq!(cut, 0),
            Resumption::Lost => assert_eq!(trial.phase, TrialPhase::None),
            Resumption::Resumed => {
                resumed += 1;
                let TrialStatus { used, checkpointed, offered, .. } = trial;
                // One that runs goes on at once.
                let is_as_kept = used == checkpointed || !is_stopped && used > checkpointed;
                assert!(checkpointed > 0 && is_as_kept && used <= offered, "cut {cut}: {trial:?}");
                patiently(|| client.stop_trial());
            }
        }
        patiently(|| match client.start_trial(3) {
            // It has started, and the answer was lost.
            Err(ClientError::Rejected(Rejection::TrialBusy)) => Ok(()),
            other => other,
        });
        if is_stopped {
            wait_for_trial(&mut client, |trial| trial.used >= SHORT_TRIAL);
            patiently(|| client.stop_trial());
        } else {
            thread::sleep(FIRST_CHECKPOINT);
        }
        if latest.is_zero() {
            let begin = Instant::now();
            wait_for_trial(&mut client, |trial| trial.checkpointed > 0);
            latest = begin.elapsed().mul_f64(LATEST_CUT);
        } else {
            thread::sleep(rng.random_range(Duration::ZERO..latest));
        }
        drop(emulator);
    }
    // The first life ends with a record; of the others, a third at least.
    assert!(resumed > lives / 6, "{resumed} of {lives}");
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn no_power_cut_leaves_a_board_without_a_valid_calibration() {
    let Lives { storing, stopped, running } = if env::var_os(ALL_WANTED).is_some() { ALL } else { SOME };
    thread::scope(|scope| {
        for seed in 0..STORING {
            scope.spawn(move || store_through_cuts(seed, storing));
        }
        scope.spawn(move || try_through_cuts(STORING, stopped, true));
        scope.spawn(move || try_through_cuts(STORING + 1, stopped, true));
        scope.spawn(move || try_through_cuts(STORING + 2, running, false));
    });
}
