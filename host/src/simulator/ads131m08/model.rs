//! The converter's behaviour: one call for each chip-select frame, one for each conversion.
//!
//! **Frames.** The response to a command leaves with the *next* frame. Whatever is no command, and whatever a lock or a
//! wrong checksum stops, is answered like a null command: with the status word. Two exceptions of the part are kept,
//! because a driver has to live with them: a register write takes effect even when its checksum is wrong (its registers
//! are written as they are shifted in, and only the acknowledgement is withheld), and a reset needs a complete frame.
//!
//! **Status.** The word is put together at the moment it leaves. Its checksum-error flag clears when it has left; its
//! reset flag stays until the host writes a zero to the bit of the same name in the `MODE` register.
//!
//! Where the datasheet is silent, the model assumes: the response after power-on is that of a reset; a write that
//! changes no register is answered like a null command; registers that cannot be written do not count as written; a
//! disabled channel reads zero.

use ftcal_shared::units::{AdcCode, DataRate};

use super::CHANNELS;
use super::buffer::ResultBuffer;
use super::frame::{self, Command, DATA_FRAME_WORDS, RegisterRange, Reply, WORD_BYTES};
use super::registers::{self, RegisterMap};

/// Bytes that the host must clock for a whole frame with conversion data.
const DATA_FRAME_BYTES: usize = DATA_FRAME_WORDS * WORD_BYTES;

const STATUS_LOCK: u16 = 1 << 15;
const STATUS_CRC_ERR: u16 = 1 << 12;

/// What the next frame begins with.
#[derive(Clone, Copy, Debug)]
enum Response {
    Status,
    Acknowledgement(u16),
    Register(u8),
    Registers(RegisterRange),
}

/// An ADS131M08, seen from its bus and its inputs.
#[derive(Clone, Debug)]
pub struct Ads131m08Model {
    identity: u16,
    registers: RegisterMap,
    response: Response,
    locked: bool,
    standby: bool,
    command_was_corrupted: bool,
    results: ResultBuffer,
}

impl Ads131m08Model {
    /// The part after power-on: every channel converting, 4000 conversions a second, gain 1.
    pub fn power_on() -> Self {
        Self::after_reset(registers::ADS131M08_ID)
    }

    fn after_reset(identity: u16) -> Self {
        let [kind, _] = identity.to_be_bytes();
        Self {
            identity,
            registers: RegisterMap::after_reset(identity),
            // FFh and what the part is: FF28h for eight channels.
            response: Response::Acknowledgement(u16::from_be_bytes([0xFF, kind])),
            locked: false,
            standby: false,
            command_was_corrupted: false,
            results: ResultBuffer::empty(),
        }
    }

    /// From here on the part says that it is this instead of an ADS131M08; nothing else of it changes.
    pub fn pretend_identity(&mut self, identity: u16) {
        self.identity = identity;
        self.registers.set_identity(identity);
    }

    /// The part says what it is again.
    pub fn admit_identity(&mut self) {
        self.pretend_identity(registers::ADS131M08_ID);
    }

    /// How often [`Ads131m08Model::convert`] is due.
    pub fn data_rate(&self) -> DataRate {
        self.registers.data_rate()
    }

    /// One chip-select frame: the bytes that the host sends, and room for those that it reads meanwhile.
    ///
    /// As many bytes are clocked as the longer of the two has; a host that sends fewer sends zeros for the rest.
    pub fn exchange(&mut self, from_host: &[u8], to_host: &mut [u8]) {
        let clocked = from_host.len().max(to_host.len());
        self.reply(clocked, to_host);
        let mut received = from_host.to_vec();
        received.resize(clocked, 0);
        self.execute(&received);
    }

    /// One conversion of these voltages between the channels' pins; true when data ready announces it.
    pub fn convert(&mut self, pin_volts: &[f64; CHANNELS]) -> bool {
        let enabled = self.registers.enabled_channels();
        if self.standby || enabled == 0 {
            return false;
        }
        let mut codes = [AdcCode::ZERO; CHANNELS];
        let inputs = self.registers.inputs();
        for (channel, ((code, input), &volts)) in codes.iter_mut().zip(&inputs).zip(pin_volts).enumerate() {
            if enabled & (1 << channel) != 0 {
                *code = input.convert(volts);
            }
        }
        self.results.put(codes, self.registers.data_ready_is_a_pulse())
    }

    fn reply(&mut self, clocked: usize, to_host: &mut [u8]) {
        let polynomial = self.registers.polynomial();
        let mut reply = Reply::default();
        match self.response {
            Response::Status => reply.push_word(self.read(registers::STATUS)),
            Response::Acknowledgement(word) => reply.push_word(word),
            Response::Register(address) => reply.push_word(self.read(address)),
            Response::Registers(range) => {
                reply.push_word(range.read_acknowledgement());
                for address in range.addresses() {
                    reply.push_word(self.read(address));
                }
            }
        }
        if !matches!(self.response, Response::Registers(_)) {
            for code in self.results.next() {
                reply.push_code(code);
            }
            if clocked >= DATA_FRAME_BYTES - WORD_BYTES {
                self.results.mark_read();
            }
        }
        reply.shift_out(polynomial, to_host);
        if self.shows_status() && clocked >= WORD_BYTES {
            self.command_was_corrupted = false;
        }
    }

    /// Whether the frame that is leaving holds the status word.
    fn shows_status(&self) -> bool {
        match self.response {
            Response::Status => true,
            Response::Acknowledgement(_) => false,
            Response::Register(address) => address == registers::STATUS,
            Response::Registers(range) => range.addresses().any(|address| address == registers::STATUS),
        }
    }

    fn execute(&mut self, from_host: &[u8]) {
        let mut words = frame::contents(from_host);
        let command = words.next().map_or(Command::Null, Command::decode);
        let intact = !self.registers.input_checksum_enabled()
            || command.checksum_matches(from_host, self.registers.polynomial());
        self.command_was_corrupted |= !intact;
        if self.locked && !command.passes_lock() {
            self.response = Response::Status;
            return;
        }
        self.response = match command {
            Command::Write(range) => {
                let acknowledgement = self.write(range, words);
                acknowledgement.filter(|_| intact).map_or(Response::Status, Response::Acknowledgement)
            }
            _ if !intact => Response::Status,
            Command::Null => Response::Status,
            Command::Reset if from_host.len() < DATA_FRAME_BYTES => Response::Acknowledgement(frame::RESET),
            Command::Reset => {
                *self = Self::after_reset(self.identity);
                return;
            }
            Command::Standby => {
                self.standby = true;
                Response::Acknowledgement(frame::STANDBY)
            }
            Command::Wakeup => {
                self.standby = false;
                Response::Acknowledgement(frame::WAKEUP)
            }
            Command::Lock => {
                self.locked = true;
                Response::Acknowledgement(frame::LOCK)
            }
            Command::Unlock => {
                self.locked = false;
                Response::Acknowledgement(frame::UNLOCK)
            }
            Command::Read(range) if range.more == 0 => Response::Register(range.first),
            Command::Read(range) => Response::Registers(range),
        };
    }

    fn write(&mut self, range: RegisterRange, values: impl Iterator<Item = u16>) -> Option<u16> {
        let mut written = 0;
        for (address, value) in range.addresses().zip(values) {
            written += u8::from(self.registers.write(address, value));
        }
        range.write_acknowledgement(written)
    }

    fn read(&self, address: u8) -> u16 {
        if address == registers::STATUS { self.status() } else { self.registers.read(address) }
    }

    fn status(&self) -> u16 {
        let mut status = self.registers.mode_in_status();
        if self.locked {
            status |= STATUS_LOCK;
        }
        if self.command_was_corrupted {
            status |= STATUS_CRC_ERR;
        }
        if self.results.has_new() {
            status |= u16::from(self.registers.enabled_channels());
        }
        status
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::DataRate;

    use super::{Ads131m08Model, DATA_FRAME_BYTES, STATUS_CRC_ERR, STATUS_LOCK};
    use crate::simulator::ads131m08::checksum::Polynomial;
    use crate::simulator::ads131m08::frame::{LOCK, RESET, Reply, STANDBY, UNLOCK, WAKEUP};

    const NULL: u16 = 0;
    const ALL_READY: u16 = 0x00FF;
    const MODE_WITH_CHECKSUM: u16 = 0x1110;

    const fn read(address: u16) -> u16 {
        0xA000 | (address << 7)
    }

    const fn write(address: u16) -> u16 {
        0x6000 | (address << 7)
    }

    /// The words, their checksum, and zeros up to a whole frame.
    fn frame(words: &[u16]) -> [u8; DATA_FRAME_BYTES] {
        let mut frame = Reply::default();
        for &word in words {
            frame.push_word(word);
        }
        let mut bytes = [0; DATA_FRAME_BYTES];
        frame.shift_out(Polynomial::Ccitt, &mut bytes);
        bytes
    }

    /// Sends a frame and returns the upper 16 bits of the words that came back, with the checksum checked.
    fn send(model: &mut Ads131m08Model, from_host: &[u8; DATA_FRAME_BYTES]) -> [u16; 9] {
        let mut to_host = [0; DATA_FRAME_BYTES];
        model.exchange(from_host, &mut to_host);
        assert_eq!(Polynomial::Ccitt.checksum(&to_host[..29]), 0, "checksum over words and checksum");
        std::array::from_fn(|word| u16::from_be_bytes([to_host[3 * word], to_host[3 * word + 1]]))
    }

    /// What a command is answered with, one frame later.
    fn ask(model: &mut Ads131m08Model, words: &[u16]) -> u16 {
        send(model, &frame(words));
        send(model, &frame(&[NULL]))[0]
    }

    /// A part whose reset flag is cleared and which demands checksums.
    fn configured() -> Ads131m08Model {
        let mut model = Ads131m08Model::power_on();
        assert_eq!(ask(&mut model, &[write(2), MODE_WITH_CHECKSUM]), 0x4000 | (2 << 7));
        model
    }

    #[test]
    fn registers_wake_up_as_the_datasheet_says() {
        let mut model = Ads131m08Model::power_on();
        assert_eq!(ask(&mut model, &[read(0)]) >> 8, 0x28);
        let expected =
            [(1, 0x0500), (2, 0x0510), (3, 0xFF0E), (4, 0), (5, 0), (6, 0x0600), (9, 0), (0x0C, 0x8000)];
        for (address, value) in expected {
            assert_eq!(ask(&mut model, &[read(address)]), value, "register {address:#04x}");
        }
    }

    #[test]
    fn what_is_written_is_read_back_one_or_several_at_a_time() {
        let mut model = configured();
        assert_eq!(ask(&mut model, &[write(3) | 2, 0xFF1A, 0x7777, 0x1234]), 0x4000 | (3 << 7) | 2);
        send(&mut model, &frame(&[read(3) | 2]));
        let reply = {
            let mut to_host = [0; DATA_FRAME_BYTES];
            model.exchange(&frame(&[NULL]), &mut to_host);
            assert_eq!(
                Polynomial::Ccitt.checksum(&to_host[..14]),
                0,
                "the checksum follows the third register"
            );
            to_host
        };
        assert_eq!(reply[..12], [0xE1, 0x82, 0, 0xFF, 0x1A, 0, 0x77, 0x77, 0, 0x12, 0x34, 0]);
        assert!(reply[15..].iter().all(|&byte| byte == 0), "no conversion data in this frame");
    }

    #[test]
    fn a_read_only_register_does_not_count_as_written() {
        let mut model = configured();
        assert_eq!(ask(&mut model, &[write(1) | 2, 0, MODE_WITH_CHECKSUM, 0xFF1A]), 0x4000 | (1 << 7) | 1);
        assert_eq!(ask(&mut model, &[write(0), 0xFFFF]), 0x0100, "nothing written: the status word");
    }

    #[test]
    fn reset_takes_a_whole_frame() {
        let mut model = configured();
        let mut nothing = [0; 6];
        model.exchange(&frame(&[RESET])[..6], &mut nothing);
        assert_eq!(send(&mut model, &frame(&[NULL]))[0], RESET);
        assert_eq!(ask(&mut model, &[read(2)]), MODE_WITH_CHECKSUM);
        assert_eq!(ask(&mut model, &[RESET]), 0xFF28);
        assert_eq!(ask(&mut model, &[NULL]), 0x0500, "reset flag, 24-bit words");
    }

    #[test]
    fn a_locked_part_ignores_writes_and_still_reads() {
        let mut model = configured();
        assert_eq!(ask(&mut model, &[LOCK]), LOCK);
        for command in [STANDBY, WAKEUP, LOCK, RESET] {
            assert_eq!(ask(&mut model, &[command]), STATUS_LOCK | 0x0100);
        }
        assert_eq!(ask(&mut model, &[write(4), 0x7777]), STATUS_LOCK | 0x0100);
        assert_eq!(ask(&mut model, &[read(4)]), 0);
        assert_eq!(ask(&mut model, &[UNLOCK]), UNLOCK);
        assert_eq!(ask(&mut model, &[write(4), 0x7777]), 0x4000 | (4 << 7));
    }

    #[test]
    fn a_corrupted_command_is_flagged_once_and_only_a_write_gets_through() {
        for bit in 0..48 {
            let mut model = configured();
            let mut broken = frame(&[STANDBY]);
            if bit % 24 >= 16 && bit >= 24 {
                continue; // the padding below the checksum carries nothing
            }
            broken[bit / 8] ^= 0x80 >> (bit % 8);
            send(&mut model, &broken);
            assert_eq!(send(&mut model, &frame(&[NULL]))[0], 0x0100 | STATUS_CRC_ERR, "bit {bit}");
            assert_eq!(send(&mut model, &frame(&[NULL]))[0], 0x0100);
            assert!(model.convert(&[0.0; 8]), "standby was not entered");
        }
        let mut model = configured();
        let mut broken = frame(&[write(4), 0x0007]);
        broken[6] ^= 1;
        send(&mut model, &broken);
        assert_eq!(send(&mut model, &frame(&[NULL]))[0], 0x0100 | STATUS_CRC_ERR, "no acknowledgement");
        assert_eq!(ask(&mut model, &[read(4)]), 0x0007);
    }

    #[test]
    fn without_input_checksum_anything_goes() {
        let mut model = Ads131m08Model::power_on();
        let mut broken = frame(&[STANDBY]);
        broken[3] ^= 1;
        send(&mut model, &broken);
        assert_eq!(send(&mut model, &frame(&[NULL]))[0], STANDBY);
        assert!(!model.convert(&[0.0; 8]));
        assert_eq!(ask(&mut model, &[WAKEUP]), WAKEUP);
        assert!(model.convert(&[0.0; 8]));
    }

    #[test]
    fn only_enabled_channels_convert_and_announce_data() {
        let mut model = configured();
        ask(&mut model, &[write(3), 0x0516]);
        assert_eq!(model.data_rate(), DataRate::Hz1000);
        assert!(model.convert(&[1.2; 8]));
        let reply = send(&mut model, &frame(&[NULL]));
        assert_eq!(reply, [0x0105, 0x7FFF, 0, 0x7FFF, 0, 0, 0, 0, 0]);
        assert_eq!(send(&mut model, &frame(&[NULL]))[0], 0x0100, "no longer new");
        ask(&mut model, &[write(3), 0x0016]);
        assert!(!model.convert(&[1.2; 8]), "no channel, no data ready");
    }

    #[test]
    fn a_missed_conversion_delays_until_two_are_read() {
        let mut model = configured();
        let volts = |code: i32| [f64::from(code) * 1.2 / 32_768.0; 8];
        for code in 1..=3 {
            assert!(model.convert(&volts(code)), "a level announces every conversion");
        }
        let first = send(&mut model, &frame(&[NULL]));
        assert_eq!((first[0] & ALL_READY, first[1]), (ALL_READY, 2), "the oldest of the last two");
        assert_eq!(send(&mut model, &frame(&[NULL]))[1], 3);
        assert_eq!(send(&mut model, &frame(&[NULL]))[..2], [0x0100, 3], "repeated, and not new");
        let mut short = [0; 6];
        model.convert(&volts(4));
        model.exchange(&[0; 6], &mut short);
        assert_eq!(send(&mut model, &frame(&[NULL]))[1], 4, "a short frame leaves the data");
    }

    #[test]
    fn an_unread_pulse_costs_the_next_conversion() {
        let mut model = configured();
        ask(&mut model, &[write(2), MODE_WITH_CHECKSUM | 1]);
        let announced = [(); 5].map(|()| model.convert(&[0.0; 8]));
        assert_eq!(announced, [true, false, true, false, true]);
    }

    #[test]
    fn a_pretended_identity_survives_a_reset() {
        let mut model = Ads131m08Model::power_on();
        model.pretend_identity(0x2401);
        assert_eq!(ask(&mut model, &[RESET]), 0xFF24);
        assert_eq!(ask(&mut model, &[read(0)]), 0x2401);
        model.admit_identity();
        assert_eq!(ask(&mut model, &[read(0)]) >> 8, 0x28);
    }
}
