//! The converter's bus with faults that can be played on it: for the self-test.
//!
//! Between driver and bus, so that everything above it (checksum, status, codes, acquisition, health) meets the fault as it would
//! meet a real one. While nothing is played a transfer passes through untouched, at the cost of one comparison.

use embedded_hal::spi::{ErrorType, Operation, SpiDevice};

use crate::adc::{FRAME_BYTES, seal};

/// What is done to the frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Injection {
    /// A bit of each reply flips.
    CorruptedReply,
    /// A bit of each command's checksum flips. (Not of the command: nobody knows what else that might be.)
    CorruptedCommand,
    /// Each reply is all ones.
    DeadLine,
    /// Each reply says that its conversion was read before.
    StaleReply,
    /// Each reply is the one before.
    LateReply,
    /// Each reply says that the converter was reset.
    Reset,
    /// A channel stands at the end of its range.
    Saturated {
        /// The channel.
        channel: u8,
    },
    /// A channel repeats its next code.
    Stuck {
        /// The channel.
        channel: u8,
    },
    /// A channel is off by half of its range.
    Jumped {
        /// The channel.
        channel: u8,
    },
}

/// Bytes of one frame.
type Bytes = [u8; FRAME_BYTES];

/// What a converter answers after a reset that it was asked for, or not.
const RESET_RESPONSE: [u8; 2] = [0xFF, 0x28];

/// A bus on which faults can be played.
pub(crate) struct Injector<Spi> {
    bus: Spi,
    playing: Option<Injection>,
    /// What the fault has to remember: the reply before, or that with the code to be repeated.
    kept: Option<Bytes>,
}

impl<Spi> Injector<Spi> {
    pub(crate) const fn new(bus: Spi) -> Self {
        Self { bus, playing: None, kept: None }
    }

    /// Plays this from the next transfer on, or nothing.
    pub(crate) const fn play(&mut self, injection: Option<Injection>) {
        self.playing = injection;
        self.kept = None;
    }
}

impl<Spi: ErrorType> ErrorType for Injector<Spi> {
    type Error = Spi::Error;
}

impl<Spi: SpiDevice> SpiDevice for Injector<Spi> {
    fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Spi::Error> {
        let Some(injection) = self.playing else { return self.bus.transaction(operations) };
        let [Operation::Transfer(read, write)] = operations else { return self.bus.transaction(operations) };
        let (Ok(reply), Ok(command)) = (<&mut Bytes>::try_from(&mut **read), <&Bytes>::try_from(*write))
        else {
            return self.bus.transaction(operations);
        };
        let mut command = *command;
        if injection == Injection::CorruptedCommand
            && let [_, _, _, sum, ..] = &mut command
        {
            *sum ^= 1;
        }
        self.bus.transaction(&mut [Operation::Transfer(reply, &command)])?;
        self.alter(injection, reply);
        Ok(())
    }
}

impl<Spi> Injector<Spi> {
    fn alter(&mut self, injection: Injection, reply: &mut Bytes) {
        let [high, low, ..] = reply;
        match injection {
            Injection::CorruptedCommand => {}
            Injection::CorruptedReply => *low ^= 1,
            Injection::DeadLine => reply.fill(0xFF),
            Injection::StaleReply => {
                *low = 0;
                seal(reply);
            }
            Injection::Reset => {
                [*high, *low] = RESET_RESPONSE;
                seal(reply);
            }
            Injection::LateReply => {
                let on_time = *reply;
                if let Some(before) = self.kept.replace(on_time) {
                    *reply = before;
                }
            }
            Injection::Saturated { channel } => change_code(reply, channel, |_| [0x7F, 0xFF, 0xFF]),
            Injection::Stuck { channel } => {
                let kept = *self.kept.get_or_insert(*reply);
                change_code(reply, channel, |_| code(&kept, channel));
            }
            Injection::Jumped { channel } => change_code(reply, channel, |[a, b, c]| [a ^ 0x40, b, c]),
        }
    }
}

/// The code of a channel, which the response comes before.
fn code(reply: &Bytes, channel: u8) -> [u8; 3] {
    let (words, _) = reply.as_chunks::<3>();
    words.get(1 + usize::from(channel)).copied().unwrap_or_default()
}

fn change_code(reply: &mut Bytes, channel: u8, change: impl Fn([u8; 3]) -> [u8; 3]) {
    let (words, _) = reply.as_chunks_mut::<3>();
    if let Some(word) = words.get_mut(1 + usize::from(channel)) {
        *word = change(*word);
    }
    seal(reply);
}
