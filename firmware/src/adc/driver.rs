//! The driver proper: bring-up, continuous reading, restart after a pause.

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::SpiDevice;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DataRate};

use super::command::{ASKING_FRAME, Command, NULL_FRAME, RESET_RESPONSE};
use super::registers::{CHANNEL_REGISTERS, ID_HIGH_BYTE, Register, channel_contents, contents};
use super::reply::Reply;
use super::settings::AdcSettings;
use super::status::Status;
use super::{CHANNELS, FRAME_WORDS, Frame, from_word};

/// From power-on to the first frame the converter listens to (t_POR).
const POWER_UP_US: u32 = 250;

/// From a reset to the first frame the converter listens to (t_REGACQ).
const RESET_US: u32 = 5;

/// The converter takes in one bit of registers 02h to 30h a clock cycle (8.3.13): 47 × 16 / 8.192 MHz = 92 µs a pass. A
/// change shows at the latest after the pass under way and a whole one, 184 µs.
const REGISTER_MAP_US: u32 = 200;

/// Periods until a conversion owes nothing to the settings before: the one under way, and three that the sinc³ filter
/// spans. The converter hands out unsettled conversions like any other (8.3.7.1.2).
const SETTLING_PERIODS: u32 = 4;

/// From a reset to the modulator's first sample: 300 of its cycles at 4.096 MHz (8.4.2), rounded up.
const MODULATOR_START_US: u32 = 74;

/// One conversion of all channels, taken at the same instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct Conversion {
    /// What the converter said of itself, free of the faults that [`Ads131m08::read_conversion`] reports; `None` where it
    /// said who it is instead.
    ///
    /// Where [`Status::data_ready`] lacks an enabled channel, that channel's code is one that was read before.
    pub status: Option<Status>,
    /// The codes, by channel; zero for a channel that is switched off.
    pub codes: [AdcCode; CHANNELS],
}

/// An ADS131M08 behind its chip-select.
///
/// The bus must be in SPI mode 1, and must hold chip-select for the whole of a transfer. It must have filled what it says it has
/// received: what it left out would be of the frame before.
#[derive(Debug)]
pub struct Ads131m08<Spi> {
    spi: Spi,
    settings: Option<AdcSettings>,
    /// The frame before asked who the converter is.
    asked: bool,
    /// What came last in continuous reading: kept, because to clear it for every frame takes as long as to take it apart.
    received: Frame,
}

impl<Spi: SpiDevice<u8>> Ads131m08<Spi> {
    /// A driver that has yet to talk to its converter: see [`Ads131m08::start`].
    pub const fn new(spi: Spi) -> Self {
        Self { spi, settings: None, asked: false, received: BLANK_FRAME }
    }

    /// The bus.
    pub const fn bus_mut(&mut self) -> &mut Spi {
        &mut self.spi
    }

    /// Gives the bus back; the converter goes on converting.
    pub fn release(self) -> Spi {
        self.spi
    }

    /// The settings of the last start, or `None` if it failed or there was none.
    pub const fn settings(&self) -> Option<AdcSettings> {
        self.settings
    }

    /// Resets the converter, sets it, locks it, makes sure what it is, reads the settings back and waits for its
    /// filters to settle. The next conversion announced is the first to be read, and fit for use.
    ///
    /// Takes 27 frames (59 for another input than the pins) and four conversion periods, at most 17 ms of waiting, whatever the
    /// converter does. It may be
    /// called at any time, whatever state the converter was left in; after a fault it starts over.
    ///
    /// # Errors
    /// The first fault met. The converter must not be read until a later start succeeds.
    pub fn start(&mut self, delay: &mut impl DelayNs, settings: AdcSettings) -> Result<(), AdcFault> {
        self.settings = None;
        self.asked = false;
        delay.delay_us(POWER_UP_US);
        self.reset(delay)?;
        let registers = contents(settings);
        for (register, value) in registers {
            self.carry_out(Command::Write(register, value))?;
        }
        if let Some(input) = channel_contents(settings) {
            for register in CHANNEL_REGISTERS {
                self.carry_out(Command::Write(register, input))?;
            }
        }
        self.carry_out(Command::Lock)?;
        // Reads come last, when commands are checked: before, a corrupted one could return another register.
        self.identify()?;
        for (register, value) in registers {
            self.verify(register, value)?;
        }
        if let Some(input) = channel_contents(settings) {
            for register in CHANNEL_REGISTERS {
                self.verify(register, input)?;
            }
        }
        delay.delay_us(settling_us(settings.data_rate));
        // The writes above changed the register map, which is no fault: this clears the flag they raised, and whether
        // the converter takes its status at the start of a frame or at the end of the one before makes no difference.
        self.response_to(Command::Null)?;
        self.discard_backlog()?;
        self.settings = Some(settings);
        Ok(())
    }

    /// Reads one conversion: one frame, with no wait. To be called once for each data-ready.
    ///
    /// # Errors
    /// Reports a frame that did not arrive whole, and a converter whose status shows that it is not, or may not be,
    /// in the state that [`Ads131m08::start`] left it in. [`AdcFault::ReplyCorrupted`] and
    /// [`AdcFault::CommandCorrupted`] cost this conversion only, and reading may go on; after
    /// [`AdcFault::UnexpectedReset`], [`AdcFault::RegisterMismatch`] and [`AdcFault::UnexpectedReply`] the settings
    /// are in doubt and a new start is due.
    pub fn read_conversion(&mut self) -> Result<Conversion, AdcFault> {
        let mut codes = [AdcCode::ZERO; CHANNELS];
        let status = self.read_codes(false, &mut codes)?;
        Ok(Conversion { status, codes })
    }

    /// As [`Ads131m08::read_conversion`], for the sample path: the codes of the first channels are written where they are to be, as many as
    /// there is room for (what is beyond the channels stays as it was), and the status comes alone. To move a whole [`Conversion`]
    /// inside of a result costs as much as to check it. With `ask` the frame asks the converter who it is; the next read, whichever it
    /// is, makes sure that it says so, and has no status.
    ///
    /// # Errors
    /// As [`Ads131m08::read_conversion`]; the codes are undefined then. The read after a question also reports
    /// [`AdcFault::WrongIdentity`], and [`AdcFault::UnexpectedReply`] where the answer is not there in time.
    pub fn read_codes(&mut self, ask: bool, codes: &mut [AdcCode]) -> Result<Option<Status>, AdcFault> {
        let asked = core::mem::replace(&mut self.asked, ask);
        exchange(&mut self.spi, if ask { &ASKING_FRAME } else { &NULL_FRAME }, &mut self.received)?;
        let Reply { response, channels } = Reply::open(&self.received)?;
        let status = if asked {
            check_answer(response)?;
            None
        } else {
            let status = Status::from_bits(response);
            if let Some(fault) = status.fault() {
                return Err(fault);
            }
            Some(status)
        };
        let (fours, rest) = codes.as_chunks_mut::<4>();
        let (fours_of_words, _) = channels.as_chunks::<4>();
        for (four, words) in fours.iter_mut().zip(fours_of_words) {
            *four = AdcCode::four_from_be_bytes(words);
        }
        for (code, word) in rest.iter_mut().zip(channels.iter().skip(4 * fours.len())) {
            *code = AdcCode::from_be_bytes(*word);
        }
        Ok(status)
    }

    /// Throws away the two conversions that the converter keeps. To be called when reading resumes after a pause, or
    /// after a data-ready was missed: otherwise every later read would return the conversion before the newest.
    ///
    /// # Errors
    /// As [`Ads131m08::read_conversion`]; both reads are made in any case.
    pub fn discard_backlog(&mut self) -> Result<(), AdcFault> {
        let older = self.read_conversion();
        let newer = self.read_conversion();
        older.and(newer).map(drop)
    }

    /// Resets the converter, which may be locked, and makes sure that it was.
    fn reset(&mut self, delay: &mut impl DelayNs) -> Result<(), AdcFault> {
        // What comes back in these two frames answers commands sent before this start, if any.
        let mut frame = BLANK_FRAME;
        exchange(&mut self.spi, &Command::Unlock.frame(), &mut frame)?;
        exchange(&mut self.spi, &Command::Reset.frame(), &mut frame)?;
        delay.delay_us(RESET_US);
        exchange(&mut self.spi, &NULL_FRAME, &mut frame)?;
        // Before the checksum: the smaller members of the family have theirs in an earlier word.
        if let Some(id) = other_family_member(&frame) {
            return Err(AdcFault::WrongIdentity { id });
        }
        match Reply::open(&frame)?.response {
            RESET_RESPONSE => Ok(()),
            response if Status::refuses_corrupted_command(response) => Err(AdcFault::CommandCorrupted),
            _ => Err(AdcFault::ResetNotAcknowledged),
        }
    }

    /// Refuses every device but the ADS131M08.
    fn identify(&mut self) -> Result<(), AdcFault> {
        let id = self.response_to(Command::Read(Register::Id))?;
        let [high, _] = id.to_be_bytes();
        if high == ID_HIGH_BYTE {
            Ok(())
        } else if Status::refuses_corrupted_command(id) {
            Err(AdcFault::CommandCorrupted)
        } else {
            Err(AdcFault::WrongIdentity { id })
        }
    }

    /// Makes sure that a register holds what was written to it.
    fn verify(&mut self, register: Register, written: u16) -> Result<(), AdcFault> {
        let value = self.response_to(Command::Read(register))?;
        if value == written {
            Ok(())
        } else if Status::refuses_corrupted_command(value) {
            Err(AdcFault::CommandCorrupted)
        } else {
            Err(AdcFault::RegisterMismatch { address: register.address() })
        }
    }

    /// Sends a command and makes sure that it was carried out.
    fn carry_out(&mut self, command: Command) -> Result<(), AdcFault> {
        let response = self.response_to(command)?;
        if command.acknowledgement() == Some(response) {
            Ok(())
        } else if Status::refuses_corrupted_command(response) {
            Err(AdcFault::CommandCorrupted)
        } else {
            Err(AdcFault::UnexpectedReply)
        }
    }

    /// Sends a command, and a NULL command to fetch its response, which comes one frame late.
    fn response_to(&mut self, command: Command) -> Result<u16, AdcFault> {
        let mut received = BLANK_FRAME;
        exchange(&mut self.spi, &command.frame(), &mut received)?;
        exchange(&mut self.spi, &NULL_FRAME, &mut received)?;
        Ok(Reply::open(&received)?.response)
    }
}

/// One chip-select frame. What is received is unchecked.
fn exchange<Spi: SpiDevice<u8>>(spi: &mut Spi, sent: &Frame, received: &mut Frame) -> Result<(), AdcFault> {
    spi.transfer(received.as_flattened_mut(), sent.as_flattened()).map_err(|_| AdcFault::Bus)
}

/// Nothing received yet.
const BLANK_FRAME: Frame = [[0; 3]; FRAME_WORDS];

/// What is wrong with a converter that answers this when it was asked who it is, while it converts.
const fn check_answer(id: u16) -> Result<(), AdcFault> {
    let [high, _] = id.to_be_bytes();
    if high == ID_HIGH_BYTE {
        Ok(())
    } else if id == RESET_RESPONSE {
        Err(AdcFault::UnexpectedReset)
    } else if Status::refuses_corrupted_command(id) {
        Err(AdcFault::CommandCorrupted)
    } else if Status::from_bits(id).is_locked() {
        // No identity: a status, which answers what was sent before.
        Err(AdcFault::UnexpectedReply)
    } else {
        Err(AdcFault::WrongIdentity { id })
    }
}

/// How long to wait after the settings were written.
const fn settling_us(data_rate: DataRate) -> u32 {
    REGISTER_MAP_US + MODULATOR_START_US + SETTLING_PERIODS * 1_000_000 / data_rate.hertz()
}

/// The ID register's upper byte, as far as a reset's response shows it, if that is the response of an ADS131M02, M03, M04
/// or M06. No single wrong bit makes one of these out of an ADS131M08's.
fn other_family_member(frame: &Frame) -> Option<u16> {
    let [response, ..] = *frame;
    let response = from_word(response);
    matches!(response, 0xFF22 | 0xFF23 | 0xFF24 | 0xFF26).then_some(response << 8)
}

#[cfg(test)]
mod tests;
