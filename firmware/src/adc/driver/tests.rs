//! The driver against a script of frames. What the converter is expected to receive, and what it answers, is written
//! here from the datasheet, word by word; only the checksum is the driver's own.

extern crate std;

use std::vec;
use std::vec::Vec;

use embedded_hal_mock::eh1::delay::NoopDelay;
use embedded_hal_mock::eh1::spi::{Mock, Transaction};
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DataRate, Gain};

use super::{Ads131m08, Conversion, settling_us};
use crate::adc::checksum::checksum;
use crate::adc::settings::{AdcSettings, ChannelMask, Input};
use crate::adc::status::Status;
use crate::adc::{CHANNELS, FRAME_WORDS, Frame, to_word};

/// What one chip-select frame sends and receives.
type Exchange = (Frame, Frame);

const SETTINGS: AdcSettings = AdcSettings {
    data_rate: DataRate::Hz4000,
    gain: Gain::X128,
    channels: ChannelMask::new(0b0011_1111),
    input: Input::Pins,
};

/// The status of a locked, healthy converter with new data on the six channels in use.
const HEALTHY: u16 = 0x813F;

fn command(words: &[u16]) -> Frame {
    let mut frame = [[0; 3]; FRAME_WORDS];
    for (word, value) in frame.iter_mut().zip(words) {
        *word = to_word(*value);
    }
    frame[words.len()] = to_word(checksum(&frame[..words.len()]));
    frame
}

fn reply_with(response: u16, codes: [[u8; 3]; 8]) -> Frame {
    let mut frame = [[0; 3]; FRAME_WORDS];
    frame[0] = to_word(response);
    frame[1..9].copy_from_slice(&codes);
    frame[9] = to_word(checksum(&frame[..9]));
    frame
}

fn reply(response: u16) -> Frame {
    reply_with(response, [[0x12, 0x34, 0x56]; 8])
}

/// A whole, uneventful start: index, what it is.
///
/// 0 unlock, 1 reset, 2 its response, 3–10 four writes, 11–12 lock, 13–14 identity, 15–22 four reads, 23–24 null,
/// 25–26 the backlog.
fn start() -> Vec<Exchange> {
    let null = command(&[0x0000]);
    let mut script =
        vec![(command(&[0x0655]), reply(0x0500)), (command(&[0x0011]), reply(0x0655)), (null, reply(0xFF28))];
    for (write, contents, acknowledgement) in [
        (0x6100, 0x3110, 0x4100),
        (0x6180, 0x3F0E, 0x4180),
        (0x6200, 0x7777, 0x4200),
        (0x6280, 0x7777, 0x4280),
    ] {
        script.push((command(&[write, contents]), reply(0x2100)));
        script.push((null, reply(acknowledgement)));
    }
    script.push((command(&[0x0555]), reply(0x2100)));
    script.push((null, reply(0x0555)));
    script.push((command(&[0xA000]), reply(0x8100)));
    script.push((null, reply(0x2801)));
    for (read, contents) in [(0xA100, 0x3110), (0xA180, 0x3F0E), (0xA200, 0x7777), (0xA280, 0x7777)] {
        script.push((command(&[read]), reply(0x8100)));
        script.push((null, reply(contents)));
    }
    script.push((null, reply(0xA13F)));
    script.push((null, reply(HEALTHY)));
    script.push((null, reply(HEALTHY)));
    script.push((null, reply(HEALTHY)));
    script
}

fn mock(script: &[Exchange]) -> Mock<u8> {
    let mut transactions = Vec::new();
    for (sent, received) in script {
        transactions.push(Transaction::transaction_start());
        transactions
            .push(Transaction::transfer(sent.as_flattened().to_vec(), received.as_flattened().to_vec()));
        transactions.push(Transaction::transaction_end());
    }
    Mock::new(&transactions)
}

/// Plays the script, checks that it was played to its end, and returns what the start made of it.
fn outcome(script: &[Exchange]) -> Result<(), AdcFault> {
    let mut adc = Ads131m08::new(mock(script));
    let result = adc.start(&mut NoopDelay::new(), SETTINGS);
    assert_eq!(adc.settings(), result.is_ok().then_some(SETTINGS));
    adc.release().done();
    result
}

/// The outcome of a start in which frame `index` brings back this instead, and which ends there.
fn outcome_with(index: usize, received: Frame) -> Result<(), AdcFault> {
    let mut script = start();
    script.truncate(index + 1);
    script[index].1 = received;
    outcome(&script)
}

fn read(received: Frame) -> Result<Conversion, AdcFault> {
    let mut adc = Ads131m08::new(mock(&[(command(&[0x0000]), received)]));
    let result = adc.read_conversion();
    adc.release().done();
    result
}

#[test]
fn starts() {
    assert_eq!(outcome(&start()), Ok(()));
}

#[test]
fn a_missing_converter_is_reported_at_the_first_reply_looked_into() {
    for level in [0x00, 0xFF] {
        let script: Vec<Exchange> =
            start().into_iter().take(3).map(|(sent, _)| (sent, [[level; 3]; FRAME_WORDS])).collect();
        assert_eq!(outcome(&script), Err(AdcFault::NotResponding));
    }
}

#[test]
fn a_reset_must_be_acknowledged() {
    assert_eq!(outcome_with(2, reply(0x0011)), Err(AdcFault::ResetNotAcknowledged));
    assert_eq!(outcome_with(2, reply(0x8100)), Err(AdcFault::ResetNotAcknowledged));
    assert_eq!(outcome_with(2, reply(0x1100)), Err(AdcFault::CommandCorrupted));
}

/// The reset response of the four-channel member, whose frame ends after six words: its checksum is out of place.
#[test]
fn another_family_member_is_refused() {
    let mut frame = [[0; 3]; FRAME_WORDS];
    frame[0] = to_word(0xFF24);
    frame[5] = to_word(checksum(&frame[..5]));
    assert_eq!(outcome_with(2, frame), Err(AdcFault::WrongIdentity { id: 0x2400 }));
}

#[test]
fn another_identity_is_refused() {
    for id in [0x2401, 0x0000, 0x8801, 0xFFFF] {
        assert_eq!(outcome_with(14, reply(id)), Err(AdcFault::WrongIdentity { id }));
    }
}

#[test]
fn any_lower_byte_of_the_identity_is_accepted() {
    for revision in 0..=0xFF {
        let mut script = start();
        script[14].1 = reply(0x2800 | revision);
        assert_eq!(outcome(&script), Ok(()));
    }
}

#[test]
fn every_write_must_be_acknowledged() {
    for index in [4, 6, 8, 10, 12] {
        assert_eq!(outcome_with(index, reply(0x4000)), Err(AdcFault::UnexpectedReply));
        assert_eq!(outcome_with(index, reply(0x1100)), Err(AdcFault::CommandCorrupted));
    }
}

#[test]
fn every_register_is_read_back() {
    for (index, address) in [(16, 2), (18, 3), (20, 4), (22, 5)] {
        assert_eq!(outcome_with(index, reply(0x0000)), Err(AdcFault::RegisterMismatch { address }));
    }
}

/// A read that arrived corrupted is answered with the status register instead.
#[test]
fn a_status_in_place_of_a_register_is_a_corrupted_command() {
    for index in [14, 16, 18, 20, 22] {
        assert_eq!(outcome_with(index, reply(0x9100)), Err(AdcFault::CommandCorrupted));
    }
}

#[test]
fn a_corrupted_reply_is_refused_wherever_one_is_looked_into() {
    let looked_into = [2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24];
    for index in looked_into {
        let mut received = start()[index].1;
        received[3][1] ^= 0x10;
        assert_eq!(outcome_with(index, received), Err(AdcFault::ReplyCorrupted), "frame {index}");
    }
}

/// The register map may have changed until the settings were in place, but not after.
#[test]
fn a_start_ends_with_a_healthy_status() {
    let mut script = start();
    script[25].1 = reply(HEALTHY | 1 << 13);
    assert_eq!(outcome(&script), Err(AdcFault::RegisterMismatch { address: 0x3E }));
}

#[test]
fn a_conversion_is_decoded() {
    let codes = [
        [0x00, 0x00, 0x00],
        [0x00, 0x00, 0x01],
        [0xFF, 0xFF, 0xFF],
        [0x7F, 0xFF, 0xFF],
        [0x80, 0x00, 0x00],
        [0x12, 0x34, 0x56],
        [0x00, 0x01, 0x00],
        [0xFF, 0xFE, 0xFF],
    ];
    let counts = [0, 1, -1, 8_388_607, -8_388_608, 0x12_3456, 256, -257];
    let conversion = read(reply_with(HEALTHY, codes));
    assert_eq!(conversion.map(|it| it.codes.map(AdcCode::counts)), Ok(counts));
    assert_eq!(conversion.map(|it| it.status.map(Status::data_ready)), Ok(Some(SETTINGS.channels)));
}

#[test]
fn continuous_reading_reports_each_fault() {
    assert_eq!(read([[0x00; 3]; FRAME_WORDS]).map(drop), Err(AdcFault::NotResponding));
    assert_eq!(read([[0xFF; 3]; FRAME_WORDS]).map(drop), Err(AdcFault::NotResponding));
    assert_eq!(read(reply(0x0500)).map(drop), Err(AdcFault::UnexpectedReset));
    assert_eq!(read(reply(0xFF28)).map(drop), Err(AdcFault::UnexpectedReset));
    assert_eq!(read(reply(HEALTHY | 1 << 12)).map(drop), Err(AdcFault::CommandCorrupted));
    assert_eq!(read(reply(HEALTHY & !(1 << 15))).map(drop), Err(AdcFault::UnexpectedReply));
    let mut received = reply(HEALTHY);
    received[8][2] ^= 1;
    assert_eq!(read(received).map(drop), Err(AdcFault::ReplyCorrupted));
}

#[test]
fn the_backlog_is_two_reads_even_if_the_first_fails() {
    let null = command(&[0x0000]);
    let mut adc = Ads131m08::new(mock(&[(null, reply(HEALTHY | 1 << 12)), (null, reply(HEALTHY))]));
    assert_eq!(adc.discard_backlog(), Err(AdcFault::CommandCorrupted));
    adc.release().done();
}

/// Longest of the datasheet's settling times (8.3.7.1.2, 8.4.2): the filter's start and, up to OSR 1024, the two further
/// periods of the sinc³ filter; above, that filter runs at 1024 inside the period.
#[test]
fn the_wait_covers_the_filters() {
    for rate in DataRate::ALL {
        let oversampling = 4_096_000 / rate.hertz();
        let modulator_cycles = 256 + 44 + oversampling + 2 * oversampling.min(1024);
        assert!(u64::from(settling_us(rate)) * 4_096_000 >= u64::from(modulator_cycles) * 1_000_000);
    }
}

/// What the read after a question makes of this answer.
fn answer(response: u16) -> Result<Option<Status>, AdcFault> {
    let script = [(command(&[0xA000]), reply(HEALTHY)), (command(&[0x0000]), reply(response))];
    let mut adc = Ads131m08::new(mock(&script));
    let status = adc.read_codes(true, &mut [AdcCode::ZERO; CHANNELS]);
    assert_eq!(status, Ok(Some(Status::from_bits(HEALTHY))));
    let result = adc.read_conversion();
    assert!(
        result.is_err() || result.map(|it| it.codes) == Ok([AdcCode::from_be_bytes([0x12, 0x34, 0x56]); 8])
    );
    adc.release().done();
    result.map(|it| it.status)
}

#[test]
fn a_question_is_answered_in_the_next_frame_or_the_converter_is_at_fault() {
    assert_eq!(answer(0x2803), Ok(None));
    assert_eq!(answer(HEALTHY), Err(AdcFault::UnexpectedReply), "the answer to the frame before: it is late");
    assert_eq!(answer(HEALTHY | 1 << 12), Err(AdcFault::CommandCorrupted));
    assert_eq!(answer(0xFF28), Err(AdcFault::UnexpectedReset));
    assert_eq!(answer(0x2400), Err(AdcFault::WrongIdentity { id: 0x2400 }));
}

/// Four settings and eight inputs, each written and read back.
#[test]
fn another_input_is_set_and_read_back_for_every_channel() {
    let mut script = start();
    let channels: Vec<u16> = (0..8).map(|channel| 0x09 + 5 * channel).collect();
    let null = command(&[0x0000]);
    let writes = channels.iter().flat_map(|address| {
        [(command(&[0x6000 | address << 7, 0b10]), reply(0x2100)), (null, reply(0x4000 | address << 7))]
    });
    let reads = channels
        .iter()
        .flat_map(|address| [(command(&[0xA000 | address << 7]), reply(0x8100)), (null, reply(0b10))]);
    script.splice(23..23, reads.collect::<Vec<_>>());
    script.splice(11..11, writes.collect::<Vec<_>>());
    let mut adc = Ads131m08::new(mock(&script));
    let settings = AdcSettings { input: Input::PositiveTestSignal, ..SETTINGS };
    assert_eq!(adc.start(&mut NoopDelay::new(), settings), Ok(()));
    assert_eq!(adc.settings(), Some(settings));
    adc.release().done();
}

#[test]
fn a_bus_error_is_reported() {
    assert_eq!(Ads131m08::new(BrokenBus).read_conversion().map(drop), Err(AdcFault::Bus));
}

struct BrokenBus;

impl embedded_hal::spi::ErrorType for BrokenBus {
    type Error = embedded_hal::spi::ErrorKind;
}

impl embedded_hal::spi::SpiDevice for BrokenBus {
    fn transaction(
        &mut self,
        _: &mut [embedded_hal::spi::Operation<'_, u8>],
    ) -> Result<(), embedded_hal::spi::ErrorKind> {
        Err(embedded_hal::spi::ErrorKind::Other)
    }
}
