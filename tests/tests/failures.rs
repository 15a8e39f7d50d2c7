//! What a sensor tells of its own failures: the image in the emulator, in which one function was made to fail.
//!
//! The function is the one that serves the wish to carry on without a gage, so that the failure comes when it is asked for. After it, the
//! sensor is reset, answers again, and knows what happened.
#![cfg(unix)]

use std::fs;
use std::path::Path;

use ftcal::simulator::bench::Bench;
use ftcal::simulator::bus::SharedBench;
use ftcal::simulator::emulator::Emulator;
use ftcal::simulator::scenario::{Scenario, ScenarioKind};
use ftcal::simulator::tunnel::Pace;
use ftcal_shared::wire::{Failure, ResetCause};
use ftcal_tests::image;
use ftcal_tests::patience::connect;
use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, ObjectSymbol};

/// In the name of the function that fails.
const FUNCTION: &str = "8carry_on";

/// An instruction that there is not.
const UNDEFINED: [u8; 2] = [0x00, 0xDE];

/// `push {r0-r7}` for ever.
const ENDLESS_PUSH: [u8; 4] = [0xFF, 0xB4, 0xFD, 0xE7];

/// The image with these instructions at the beginning of the function, in this file; where that is.
fn write_image(instructions: &[u8], path: &Path) -> u32 {
    let mut bytes = fs::read(image::path("ftcal-emulated.elf")).unwrap();
    let (address, offset) = {
        let elf = ElfFile32::<object::Endianness>::parse(&*bytes).unwrap();
        let mut found = elf.symbols().filter(|symbol| symbol.name().unwrap().contains(FUNCTION));
        let function = found.next().expect("the image has the function");
        assert!(found.next().is_none(), "more than one function of this name");
        // The lowest bit says that it is Thumb code.
        let address = function.address() & !1;
        let section = elf.section_by_index(function.section_index().unwrap()).unwrap();
        let (begin, _) = section.file_range().unwrap();
        (address, usize::try_from(begin + address - section.address()).unwrap())
    };
    bytes[offset..offset + instructions.len()].copy_from_slice(instructions);
    fs::write(path, bytes).unwrap();
    u32::try_from(address).unwrap()
}

/// What the sensor says of its reset, after it was asked for what it fails at; and where that is.
fn failure_of(instructions: &[u8]) -> (Option<Failure>, u32) {
    let folder = tempfile::tempdir().unwrap();
    let image = folder.path().join("image.elf");
    let address = write_image(instructions, &image);
    let scenario = Scenario::new(ScenarioKind::Wrist, 1).unwrap();
    let bench = SharedBench::new(Bench::new(scenario.sensor, 1));
    let emulator = Emulator::start(&image, bench, Pace::RealTime).unwrap();
    let mut client = connect(&emulator);
    let before = client.diagnosis().unwrap();
    assert_eq!((before.failure, before.reset == ResetCause::Watchdog), (None, false));
    client.carry_on_without(None).unwrap_err();
    drop(client);
    let mut client = connect(&emulator);
    let failure = client.diagnosis().unwrap().failure;
    // It is told until the next reset, and the sensor is at work again.
    assert_eq!(client.diagnosis().unwrap().failure, failure);
    client.wait_for_converter().unwrap();
    (failure, address)
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn a_fault_of_the_processor_is_told_with_its_address() {
    let (failure, address) = failure_of(&UNDEFINED);
    assert_eq!(failure, Some(Failure::ProcessorFault { at: address }));
}

#[test]
#[ignore = "needs the images and the emulator: tests/run provides both"]
fn a_stack_that_overflows_is_told() {
    let (failure, _) = failure_of(&ENDLESS_PUSH);
    assert_eq!(failure, Some(Failure::StackOverflow));
}
