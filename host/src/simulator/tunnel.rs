//! The host's end of the emulator's tunnel: a converter model, a flash and a panel behind a serial line. For the protocol see
//! [`ftcal_firmware::tunnel`].
//!
//! The converter's clock is the bench's virtual time. [`serve`] lets it pass as fast as the [`Pace`] says, but never
//! converts again before the board has handled the last announcement: a board that is slow makes the converter slow, and
//! misses nothing. Where the board says nothing for [`UNHANDLED_MICROS`], the converter goes on, as a real one does.

use std::io::{self, Read, Write};
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use embedded_storage::nor_flash::{NorFlash, ReadNorFlash};
use ftcal_firmware::storage::layout::SECTOR;
use ftcal_firmware::tunnel::{
    FlashAction, FlashAnswer, FlashBytes, FlashQuestion, FromBoard, FromConverter, Transfer, UNHANDLED_MICROS,
};
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::{Decoder, encode};

use super::bench::Bench;
use super::bus::SharedBench;
use super::flash::SimulatedFlash;
use super::panel::SharedPanel;

/// Bytes taken from the line at once.
const CHUNK: usize = 1024;

/// A converter with a clock of its own.
pub trait TunnelledConverter {
    /// One chip-select frame: as many bytes in either direction.
    fn exchange(&mut self, from_board: &[u8], to_board: &mut [u8]);

    /// Lets one conversion period pass; whether data-ready announces the conversion.
    fn next_conversion(&mut self) -> bool;

    /// The converter's clock.
    fn now(&self) -> DeviceTime;
}

impl TunnelledConverter for SharedBench {
    fn exchange(&mut self, from_board: &[u8], to_board: &mut [u8]) {
        self.with(|bench| bench.exchange(from_board, to_board));
    }

    fn next_conversion(&mut self) -> bool {
        self.with(Bench::next_conversion)
    }

    fn now(&self) -> DeviceTime {
        self.with(|bench| bench.now())
    }
}

/// How fast the converter's clock runs at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As fast as a clock on the wall.
    RealTime,
    /// As fast as announcements are handled; as fast as a clock on the wall where there are none.
    AsHandled,
}

/// Serves converter, flash and panel to the board at the other end of the line, until the line is closed.
///
/// # Errors
///
/// That of the line, where it does not take what is to be sent.
pub fn serve(
    reader: impl Read + Send,
    mut writer: impl Write,
    converter: &mut impl TunnelledConverter,
    flash: &mut SimulatedFlash,
    panel: &SharedPanel,
    pace: Pace,
) -> io::Result<()> {
    let (sender, messages) = channel();
    thread::scope(|scope| {
        scope.spawn(move || pass_on(reader, &sender));
        // A board that has not said anything yet is still starting, and would not hear an announcement.
        let Ok(first) = messages.recv() else { return Ok(()) };
        let mut event = Ok(first);
        let mut due = Instant::now();
        // The last announcement, as long as it is not handled.
        let mut unhandled: Option<Instant> = None;
        let mut told_pressed = false;
        loop {
            let is_pressed = panel.is_pressed();
            if is_pressed != told_pressed {
                send(&mut writer, &FromConverter::Button { is_pressed })?;
                told_pressed = is_pressed;
            }
            match event {
                Ok(FromBoard::Transfer(question)) => {
                    send(&mut writer, &FromConverter::Transferred(answer(&question, converter)))?;
                }
                Ok(FromBoard::Handled) => unhandled = None,
                Ok(FromBoard::Light { is_lit }) => panel.set_light(is_lit),
                Ok(FromBoard::Flash(question)) => {
                    let answer = answer_of_flash(&question, flash);
                    if !flash.is_powered() {
                        // A board whose power has failed hears nothing any more, least of all that its flash has.
                        return Ok(());
                    }
                    send(&mut writer, &FromConverter::Flash(answer))?;
                }
                Err(RecvTimeoutError::Timeout) => {
                    let before = converter.now();
                    let announced = converter.next_conversion();
                    let now = converter.now();
                    due = match pace {
                        Pace::AsHandled if announced => Instant::now(),
                        // A period after it was due; whoever is late by more than that does not catch up.
                        Pace::AsHandled | Pace::RealTime => (due + elapsed(before, now)).max(Instant::now()),
                    };
                    unhandled = announced.then(Instant::now);
                    if announced {
                        send(&mut writer, &FromConverter::DataReady(now))?;
                    }
                }
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            let until =
                unhandled.map_or(due, |announced| announced + Duration::from_micros(UNHANDLED_MICROS));
            event = messages.recv_timeout(until.saturating_duration_since(Instant::now()));
        }
    })
}

/// The reader thread: bytes into messages, until the line or the server is gone. What is broken is dropped; the board
/// notices that the answer is missing.
fn pass_on(mut reader: impl Read, sender: &Sender<FromBoard>) {
    let mut decoder = Decoder::new();
    let mut chunk = [0; CHUNK];
    loop {
        let length = match reader.read(&mut chunk) {
            Ok(0) => return,
            Ok(length) => length,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(_) => return,
        };
        for &byte in chunk.iter().take(length) {
            if let Some(Ok(message)) = decoder.push::<FromBoard>(byte)
                && sender.send(message).is_err()
            {
                return;
            }
        }
    }
}

fn answer(question: &Transfer, converter: &mut impl TunnelledConverter) -> Transfer {
    let mut bytes = question.bytes.clone();
    converter.exchange(&question.bytes, &mut bytes);
    Transfer { number: question.number, bytes }
}

fn answer_of_flash(question: &FlashQuestion, flash: &mut SimulatedFlash) -> FlashAnswer {
    let done = match &question.action {
        FlashAction::Read { offset, length } => {
            let mut bytes = FlashBytes::new();
            let fits = bytes.resize(usize::from(*length), 0).is_ok();
            (fits && flash.read(*offset, &mut bytes).is_ok()).then_some(bytes)
        }
        FlashAction::Write { offset, bytes } => flash.write(*offset, bytes).is_ok().then(FlashBytes::new),
        FlashAction::Erase { offset } => {
            let end = offset.saturating_add(SECTOR);
            flash.erase(*offset, end).is_ok().then(FlashBytes::new)
        }
    };
    FlashAnswer { number: question.number, bytes: done }
}

fn send(writer: &mut impl Write, message: &FromConverter) -> io::Result<()> {
    let frame = encode(message).map_err(|_| io::Error::other("a message of the tunnel is too long"))?;
    writer.write_all(&frame)
}

fn elapsed(begin: DeviceTime, end: DeviceTime) -> Duration {
    Duration::from_micros(end.as_micros().saturating_sub(begin.as_micros()))
}

#[cfg(test)]
mod tests {
    use std::io::{PipeReader, Read, Write, pipe};
    use std::thread;
    use std::time::{Duration, Instant};

    use ftcal_firmware::tunnel::{
        FlashAction, FlashAnswer, FlashBytes, FlashQuestion, FromBoard, FromConverter, Transfer,
        TransferBytes, UNHANDLED_MICROS,
    };
    use ftcal_shared::units::DeviceTime;
    use ftcal_shared::wire::frame::{Decoder, encode};

    use super::{Pace, SharedPanel, SimulatedFlash, TunnelledConverter, serve};

    const PERIOD_MICROS: u64 = 2_000;

    /// Answers every byte with its complement, and counts conversions.
    struct Complement {
        conversions: u64,
    }

    impl TunnelledConverter for Complement {
        fn exchange(&mut self, from_board: &[u8], to_board: &mut [u8]) {
            for (reply, byte) in to_board.iter_mut().zip(from_board) {
                *reply = !byte;
            }
        }

        fn next_conversion(&mut self) -> bool {
            self.conversions += 1;
            true
        }

        fn now(&self) -> DeviceTime {
            DeviceTime::from_micros(self.conversions * PERIOD_MICROS)
        }
    }

    /// The board's end: the next whole message.
    fn receive(line: &mut PipeReader) -> FromConverter {
        let mut decoder = Decoder::new();
        loop {
            let mut byte = [0];
            line.read_exact(&mut byte).unwrap();
            if let Some(message) = decoder.push(byte[0]) {
                return message.unwrap();
            }
        }
    }

    /// Plays the board for a while and returns how many conversions there were.
    fn conversions_while(pace: Pace, board: impl FnOnce(&mut PipeReader, &mut dyn Write)) -> u64 {
        conversions_with(&SharedPanel::default(), pace, board)
    }

    fn conversions_with(
        panel: &SharedPanel,
        pace: Pace,
        board: impl FnOnce(&mut PipeReader, &mut dyn Write),
    ) -> u64 {
        let panel = panel.clone();
        let (from_board, mut to_converter) = pipe().unwrap();
        let (mut from_converter, to_board) = pipe().unwrap();
        let server = thread::spawn(move || {
            let mut converter = Complement { conversions: 0 };
            let mut flash = SimulatedFlash::default();
            serve(from_board, to_board, &mut converter, &mut flash, &panel, pace)
                .map(|()| converter.conversions)
        });
        // Nothing is announced before the board has spoken.
        to_converter.write_all(&encode(&FromBoard::Handled).unwrap()).unwrap();
        board(&mut from_converter, &mut to_converter);
        drop(to_converter);
        server.join().unwrap().unwrap()
    }

    fn question(number: u8) -> Vec<u8> {
        let bytes = TransferBytes::from_slice(&[number, 0x0F]).unwrap();
        encode(&FromBoard::Transfer(Transfer { number, bytes })).unwrap().to_vec()
    }

    /// Handles one announcement: each answer must bear its question's number.
    fn handle_conversion(number: u8, from_converter: &mut PipeReader, to_converter: &mut dyn Write) -> u64 {
        let FromConverter::DataReady(time) = receive(from_converter) else { panic!("nothing was asked") };
        // Several transfers in a row do not move the converter's time.
        for _ in 0..3 {
            to_converter.write_all(&question(number)).unwrap();
            let bytes = TransferBytes::from_slice(&[!number, 0xF0]).unwrap();
            assert_eq!(receive(from_converter), FromConverter::Transferred(Transfer { number, bytes }));
        }
        to_converter.write_all(&encode(&FromBoard::Handled).unwrap()).unwrap();
        time.as_micros()
    }

    #[test]
    fn no_conversion_is_skipped_however_slow_the_board() {
        conversions_while(Pace::AsHandled, |from_converter, to_converter| {
            for conversion in 1..=20 {
                thread::sleep(Duration::from_millis(u64::from(conversion) % 5));
                let time = handle_conversion(conversion, from_converter, to_converter);
                assert_eq!(time, u64::from(conversion) * PERIOD_MICROS);
            }
        });
    }

    #[test]
    fn the_converter_is_no_faster_than_the_clock_on_the_wall() {
        let begin = Instant::now();
        let conversions = conversions_while(Pace::RealTime, |from_converter, to_converter| {
            for conversion in 0..50 {
                handle_conversion(conversion, from_converter, to_converter);
            }
        });
        assert!(begin.elapsed() >= Duration::from_micros((conversions - 2) * PERIOD_MICROS));
    }

    #[test]
    fn a_conversion_that_nobody_reads_is_left_behind() {
        let begin = Instant::now();
        conversions_while(Pace::AsHandled, |from_converter, _| {
            receive(from_converter);
            let FromConverter::DataReady(time) = receive(from_converter) else { panic!("nothing was asked") };
            assert_eq!(time.as_micros(), 2 * PERIOD_MICROS);
        });
        assert!(begin.elapsed() >= Duration::from_micros(UNHANDLED_MICROS));
    }

    #[test]
    fn a_broken_question_is_not_answered_and_the_next_one_is() {
        conversions_while(Pace::AsHandled, |from_converter, to_converter| {
            let mut broken = question(1);
            broken[2] ^= 1;
            to_converter.write_all(&broken).unwrap();
            handle_conversion(2, from_converter, to_converter);
        });
    }

    #[test]
    fn the_board_hears_of_the_button_and_the_light_is_as_it_says() {
        let panel = SharedPanel::default();
        conversions_with(&panel, Pace::RealTime, |from_converter, to_converter| {
            for turn in [true, false] {
                panel.press(turn);
                while receive(from_converter) != (FromConverter::Button { is_pressed: turn }) {}
                to_converter.write_all(&encode(&FromBoard::Light { is_lit: turn }).unwrap()).unwrap();
                let begin = Instant::now();
                while panel.light() != turn {
                    assert!(begin.elapsed() < Duration::from_secs(10));
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
    }

    #[test]
    fn the_flash_is_read_as_it_was_written_and_says_no_beyond_its_end() {
        conversions_while(Pace::RealTime, |from_converter, to_converter| {
            let mut ask = |number, action| {
                let question = FromBoard::Flash(FlashQuestion { number, action });
                to_converter.write_all(&encode(&question).unwrap()).unwrap();
                loop {
                    match receive(from_converter) {
                        FromConverter::Flash(FlashAnswer { number: answered, bytes }) => {
                            assert_eq!(answered, number);
                            return bytes;
                        }
                        FromConverter::DataReady(_) => {}
                        FromConverter::Transferred(_) | FromConverter::Button { .. } => {
                            panic!("nothing was asked")
                        }
                    }
                }
            };
            let bytes = FlashBytes::from_slice(&[1, 2, 3, 4]).unwrap();
            assert_eq!(ask(1, FlashAction::Write { offset: 8, bytes }), Some(FlashBytes::new()));
            let read = ask(2, FlashAction::Read { offset: 7, length: 3 }).unwrap();
            assert_eq!(read, [0xFF, 1, 2]);
            assert_eq!(ask(3, FlashAction::Erase { offset: 0 }), Some(FlashBytes::new()));
            assert_eq!(ask(4, FlashAction::Read { offset: 8, length: 1 }).unwrap(), [0xFF]);
            assert_eq!(ask(5, FlashAction::Read { offset: u32::MAX, length: 1 }), None);
            assert_eq!(ask(6, FlashAction::Erase { offset: u32::MAX }), None);
        });
    }
}
