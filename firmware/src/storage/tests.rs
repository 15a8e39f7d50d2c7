//! The promise of [`super`], with the power failing at every word and at every stage of every erase.

extern crate std;

use std::vec::Vec;

use ftcal_shared::units::{DataRate, Dof, Gain};
use ftcal_shared::wire::{CalibrationOrigin, CalibrationUpload, GageList, KeptCalibration, KeptCalibrations};

use super::items::{Counters, Name, Settings, StoredCalibration};
use super::layout::{SECTOR, WORD};
use super::memory::{Kept, Memory, StorageError};
use super::mock::{ERASE_STAGES, MockFlash};
use super::record::Missing;

type TestMemory = Memory<MockFlash>;

/// A calibration that no other number gives.
fn calibration(number: u32) -> StoredCalibration {
    let bias_counts = GageList::from_slice(&[f64::from(number); 8]).unwrap();
    let matrix = (0..48_u8).map(|element| f32::from(element) / 16.0).collect();
    let mut upload =
        CalibrationUpload { dof: Dof::SpatialForceTorque, gain: Gain::X64, bias_counts, matrix, identity: 0 };
    upload.identity = upload.identity_of_numbers();
    StoredCalibration { upload, origin: CalibrationOrigin::Uploaded }
}

fn identity(number: u32) -> u32 {
    calibration(number).upload.identity
}

fn kept(current: u32, previous: Option<u32>) -> KeptCalibrations {
    KeptCalibrations {
        current: KeptCalibration::Calibration(identity(current)),
        previous: previous.map(identity),
    }
}

fn read(memory: &mut TestMemory) -> Kept {
    memory.read().unwrap()
}

/// A memory in which these were stored, one after the other.
fn after_storing(numbers: impl IntoIterator<Item = u32>) -> TestMemory {
    let mut memory = Memory::new(MockFlash::new());
    for number in numbers {
        memory.store_calibration(&calibration(number)).unwrap();
    }
    memory
}

/// Cuts the power at every instant of `act`, and once not at all, and has `check` look at what came of it. How often it was cut.
fn cut_everywhere(
    before: &MockFlash,
    act: impl Fn(&mut TestMemory) -> Result<(), StorageError>,
    check: impl Fn(&mut TestMemory),
) -> u32 {
    for fuel in 1.. {
        let mut memory = Memory::new(before.failing_after(fuel, 0x9E37_79B9 * u64::from(fuel)));
        let outcome = act(&mut memory);
        let failed = memory.flash().has_failed();
        assert_eq!(outcome.is_err(), failed, "fuel {fuel}: {outcome:?}");
        let flash = memory.flash().clone().restored();
        check(&mut Memory::new(flash));
        if !failed {
            return fuel - 1;
        }
    }
    0
}

/// The memory goes on as if nothing had happened.
fn goes_on(memory: &mut TestMemory) {
    for number in [1000, 1001] {
        memory.store_calibration(&calibration(number)).unwrap();
    }
    assert_eq!(read(memory).calibrations, kept(1001, Some(1000)));
    assert_eq!(read(memory).calibration, Some(calibration(1001)));
}

/// As often as it takes until the next store of this calibration needs an erase.
fn until_an_erase_is_due(next: u32) -> MockFlash {
    let mut memory = after_storing([1, 2]);
    memory.store(&Settings { data_rate: DataRate::Hz250, gain: Gain::X1 }).unwrap();
    loop {
        for number in [1, 2] {
            let mut trial = Memory::new(memory.flash().clone());
            trial.store_calibration(&calibration(next)).unwrap();
            if number == 1 && trial.flash().erased > memory.flash().erased {
                return memory.flash().clone();
            }
            memory.store_calibration(&calibration(number)).unwrap();
        }
    }
}

#[test]
fn a_new_flash_holds_nothing_and_a_foreign_one_neither() {
    let factory = MockFlash::new();
    let foreign = MockFlash::filled_with(|word| word.wrapping_mul(0x9E37_79B9));
    for flash in [factory, foreign] {
        let mut memory = Memory::new(flash);
        let found = read(&mut memory);
        assert_eq!((found.calibration, found.settings), (None, None));
        assert_eq!(found.calibrations.current, KeptCalibration::Nothing);
        assert_eq!(memory.load::<Name>().unwrap(), Err(Missing::Nothing));
        goes_on(&mut memory);
    }
}

#[test]
fn a_new_flash_may_lose_power_while_it_is_prepared() {
    let foreign = MockFlash::filled_with(|word| word.wrapping_mul(0x9E37_79B9));
    let cuts = cut_everywhere(
        &foreign,
        |memory| memory.read().map(|_| ()),
        |memory| {
            assert_eq!(read(memory).calibrations.current, KeptCalibration::Nothing);
            goes_on(memory);
        },
    );
    assert!(cuts > 2 * ERASE_STAGES);
}

#[test]
fn what_was_stored_is_found_after_a_reset() {
    let mut memory = after_storing([1, 2, 3]);
    let settings = Settings { data_rate: DataRate::Hz8000, gain: Gain::X32 };
    memory.store(&settings).unwrap();
    memory.store(&Name("left wrist".try_into().unwrap())).unwrap();
    let mut memory = Memory::new(memory.flash().clone());
    let found = memory.start().unwrap();
    assert_eq!(found.calibration, Some(calibration(3)));
    assert_eq!(found.calibrations, kept(3, Some(2)));
    assert_eq!(found.settings, Some(settings));
    let identity = found.identity;
    assert_eq!((identity.name.as_str(), identity.boots, identity.stores), ("left wrist", 1, 3));
}

#[test]
fn a_rollback_swaps_and_may_be_repeated() {
    let mut memory = after_storing([1, 2]);
    for _ in 0..2 {
        memory.roll_back(identity(1)).unwrap();
        let found = read(&mut memory);
        assert_eq!((found.calibration, found.calibrations), (Some(calibration(1)), kept(1, Some(2))));
    }
    assert_eq!(read(&mut memory).calibrations, kept(1, Some(2)));
    assert_eq!(memory.roll_back(identity(3)), Err(StorageError::NoSuchCalibration));
    memory.roll_back(identity(2)).unwrap();
    assert_eq!(read(&mut memory).calibration, Some(calibration(2)));
}

#[test]
fn storing_what_is_stored_writes_nothing() {
    let mut memory = after_storing([1, 2]);
    let written = memory.flash().written;
    memory.store_calibration(&calibration(2)).unwrap();
    memory.roll_back(identity(2)).unwrap();
    assert_eq!(memory.flash().written, written);
    // The same numbers at another gain are another calibration.
    let mut other = calibration(2);
    other.upload.gain = Gain::X1;
    other.upload.identity = other.upload.identity_of_numbers();
    memory.store_calibration(&other).unwrap();
    assert_eq!(read(&mut memory).calibration, Some(other));
    memory.roll_back(identity(2)).unwrap();
    assert_eq!(read(&mut memory).calibration, Some(calibration(2)));
}

#[test]
fn a_cut_store_leaves_the_old_calibration_or_the_new_one() {
    let before = after_storing([1, 2]).flash().clone();
    let cuts = cut_everywhere(
        &before,
        |memory| memory.store_calibration(&calibration(3)),
        |memory| {
            let found = read(memory);
            let expected = match found.calibrations.current {
                KeptCalibration::Calibration(current) if current == identity(3) => (3, kept(3, Some(2))),
                _ => (2, kept(2, Some(1))),
            };
            assert_eq!((found.calibration, found.calibrations), (Some(calibration(expected.0)), expected.1));
            goes_on(memory);
        },
    );
    // At least every word of the calibration, of two rosters and of the counters.
    assert!(cuts > 80, "{cuts}");
}

#[test]
fn the_first_store_leaves_nothing_or_all() {
    let mut memory = Memory::new(MockFlash::new());
    memory.read().unwrap();
    cut_everywhere(
        &memory.flash().clone(),
        |memory| memory.store_calibration(&calibration(1)),
        |memory| {
            let found = read(memory);
            match found.calibration {
                None => assert_eq!(
                    found.calibrations,
                    KeptCalibrations { current: KeptCalibration::Nothing, previous: None }
                ),
                Some(stored) => assert_eq!((stored, found.calibrations), (calibration(1), kept(1, None))),
            }
            goes_on(memory);
        },
    );
}

#[test]
fn a_cut_rollback_leaves_either_calibration() {
    let before = after_storing([1, 2]).flash().clone();
    let cuts = cut_everywhere(
        &before,
        |memory| memory.roll_back(identity(1)),
        |memory| {
            let found = read(memory).calibrations;
            assert!(found == kept(1, Some(2)) || found == kept(2, Some(1)), "{found:?}");
            assert!(read(memory).calibration.is_some());
            memory.roll_back(identity(1)).unwrap();
            assert_eq!(read(memory).calibration, Some(calibration(1)));
        },
    );
    assert!(cuts > 10);
}

#[test]
fn cut_settings_are_the_old_ones_or_the_new_ones() {
    let settings = |data_rate| Settings { data_rate, gain: Gain::X16 };
    let mut memory = after_storing([1]);
    memory.store(&settings(DataRate::Hz250)).unwrap();
    cut_everywhere(
        &memory.flash().clone(),
        |memory| memory.store(&settings(DataRate::Hz32000)),
        |memory| {
            let found = read(memory).settings.unwrap();
            assert!([settings(DataRate::Hz250), settings(DataRate::Hz32000)].contains(&found));
            assert_eq!(read(memory).calibration, Some(calibration(1)));
        },
    );
}

#[test]
fn a_cut_while_a_full_sector_gives_way_loses_nothing() {
    let before = until_an_erase_is_due(3);
    let settings = read(&mut Memory::new(before.clone())).settings;
    assert!(settings.is_some());
    let cuts = cut_everywhere(
        &before,
        |memory| memory.store_calibration(&calibration(3)),
        |memory| {
            let found = read(memory);
            let is_new = found.calibrations == kept(3, Some(2));
            assert!(is_new || found.calibrations == kept(2, Some(1)), "{:?}", found.calibrations);
            assert_eq!(found.calibration, Some(calibration(if is_new { 3 } else { 2 })));
            assert_eq!(found.settings, settings);
            memory.roll_back(identity(if is_new { 2 } else { 1 })).unwrap();
            goes_on(memory);
        },
    );
    assert!(cuts > 300 + ERASE_STAGES, "{cuts}");
}

#[test]
fn a_second_cut_while_the_first_is_mended_loses_nothing() {
    let before = until_an_erase_is_due(3);
    let mut cut_twice = 0;
    let mut fuel = 1;
    loop {
        let mut memory = Memory::new(before.failing_after(fuel, u64::from(fuel)));
        if memory.store_calibration(&calibration(3)).is_ok() {
            break;
        }
        let torn = memory.flash().clone().restored();
        // What mends it: reading, which ends an erase, or the next store, which moves the items again.
        cut_twice += cut_everywhere_in_steps(
            &torn,
            17,
            |memory| memory.start().map(|_| ()),
            |memory| {
                let found = read(memory);
                let is_new = found.calibrations == kept(3, Some(2));
                assert!(is_new || found.calibrations == kept(2, Some(1)), "{:?}", found.calibrations);
                assert_eq!(found.calibration, Some(calibration(if is_new { 3 } else { 2 })));
            },
        );
        fuel += 13;
    }
    assert!(cut_twice > 100, "{cut_twice}");
}

fn cut_everywhere_in_steps(
    before: &MockFlash,
    step: u32,
    act: impl Fn(&mut TestMemory) -> Result<(), StorageError>,
    check: impl Fn(&mut TestMemory),
) -> u32 {
    let mut cuts = 0;
    for fuel in (1..).step_by(step as usize) {
        let mut memory = Memory::new(before.failing_after(fuel, u64::from(fuel)));
        let outcome = act(&mut memory);
        check(&mut Memory::new(memory.flash().clone().restored()));
        if outcome.is_ok() {
            break;
        }
        cuts += 1;
    }
    cuts
}

#[test]
fn power_that_fails_again_and_again_at_the_same_step_wears_nothing_but_time() {
    // Twenty cuts in a row while items move; then it succeeds.
    let mut flash = until_an_erase_is_due(3);
    for attempt in 0..20 {
        let mut memory = Memory::new(flash.failing_after(60 + attempt, u64::from(attempt) + 1));
        assert!(memory.store_calibration(&calibration(3)).is_err());
        flash = memory.flash().clone().restored();
        assert_eq!(read(&mut Memory::new(flash.clone())).calibration, Some(calibration(2)));
    }
    goes_on(&mut Memory::new(flash));
}

#[test]
fn thousands_of_stores_cost_few_erases() {
    let mut memory = after_storing([]);
    for number in 0..1000 {
        memory.store_calibration(&calibration(number)).unwrap();
    }
    assert_eq!(read(&mut memory).calibrations, kept(999, Some(998)));
    let erases = memory.flash().erased;
    assert!(erases <= 8, "{erases}");
}

/// Of what is worn out, at most that is lost which is in the worn word, and nothing is taken for what it is not.
#[test]
fn no_worn_word_makes_a_wrong_calibration() {
    let before = after_storing([1, 2]).flash().clone();
    let places: Vec<u32> = before.written_addresses();
    let (mut corrupt, mut whole, mut nothing) = (0, 0, 0);
    for &address in &places {
        assert!(address >= 2 * SECTOR && address.is_multiple_of(WORD));
        for bits in [1, 1 << 17, u32::MAX] {
            let mut flash = before.clone();
            flash.corrupt(address, bits);
            let found = read(&mut Memory::new(flash));
            match found.calibrations.current {
                KeptCalibration::Calibration(current) => {
                    whole += 1;
                    assert_eq!(
                        (current, found.calibration),
                        (identity(2), Some(calibration(2))),
                        "{address:#x}"
                    );
                }
                KeptCalibration::Corrupt => {
                    corrupt += 1;
                    assert_eq!((found.calibration, found.calibrations.previous), (None, Some(identity(1))));
                }
                // The mark of the page itself, with all its bits at once.
                KeptCalibration::Nothing => nothing += 1,
                other => panic!("{address:#x}: {other:?}"),
            }
        }
    }
    assert!(corrupt > 90 && whole > corrupt && nothing <= 1, "{corrupt} {whole} {nothing}");
}

#[test]
fn after_a_corrupt_calibration_the_previous_one_can_be_brought_back() {
    let before = after_storing([1, 2]).flash().clone();
    let is_corrupt = |address: &u32| {
        let mut flash = before.clone();
        flash.corrupt(*address, 1);
        read(&mut Memory::new(flash)).calibrations.current == KeptCalibration::Corrupt
    };
    let address = before.written_addresses().into_iter().find(is_corrupt).unwrap();
    let mut flash = before.clone();
    flash.corrupt(address, 1);
    let mut memory = Memory::new(flash);
    memory.roll_back(identity(1)).unwrap();
    assert_eq!(read(&mut memory).calibration, Some(calibration(1)));
    assert_eq!(memory.load::<Counters>().unwrap().map(|counters| counters.stores), Ok(3));
}
