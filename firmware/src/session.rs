//! The conversation with the host: bytes in, orders out; the greeting, which needs nothing else of the sensor; and what becomes
//! of a conversation that the host does not go on with.
//!
//! # A request may come again
//!
//! The host repeats what is not answered in time: the request may have been lost, or its answer. The session keeps the number of
//! the last request and its answer. The same number once more is not served again: it gets the same answer, or, where that is
//! still being worked on, none yet. So nothing is done twice, whatever is lost, and the host need not know what is safe to
//! repeat. A greeting begins a new conversation, whose numbers are its own.
//!
//! # A host that falls silent
//!
//! A host shows that it is there by anything that it says, repeated or not. After [`HOST_SILENCE_MICROS`] without a word nobody is
//! listening: the board ends the stream (which would keep the flash from being erased, among other things), and goes back to
//! [`DEFAULT_BAUD`], where the next host will look for it.
//!
//! # Another rate
//!
//! A request for another baud rate is answered at the old one; once that has left, the board changes. The host is then to say
//! something at the new rate within [`RATE_TRIAL_MICROS`], or the board takes it that the line does not carry this rate and goes
//! back.
//!
//! Garbage costs at most the frame that it runs into: a frame ends with a byte that nothing else contains, and the decoder is at
//! its place again after the next one.

use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::frame::Decoder;
use ftcal_shared::wire::{Hello, PRODUCT, PROTOCOL_VERSION, Request, RequestId, Response, ToDevice, ToHost};

use crate::baud::DEFAULT_BAUD;

/// How long a host may say nothing before it counts as gone.
pub const HOST_SILENCE_MICROS: u64 = 5_000_000;

/// How long the host has to say something at a new rate.
pub const RATE_TRIAL_MICROS: u64 = 1_000_000;

/// Which request of which conversation: what is asked in one is not answered in the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticket {
    id: RequestId,
    conversation: u8,
}

/// What is to be done about what came from the host.
#[derive(Clone, Debug, PartialEq)]
pub enum Order {
    /// Send this.
    Send(ToHost),
    /// Have the sensor serve this request, and have the session [`answer`](Session::answer) it.
    Serve(Ticket, Request),
    /// Change to this baud rate if that is possible, after the answer has left, and have the session [`answer`](Session::answer).
    ChangeRate(Ticket, u32),
}

/// What is to be done about a host that says nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Silence {
    /// Nobody listens: end the stream.
    pub end_stream: bool,
    /// Nobody is heard at this rate: go back to [`DEFAULT_BAUD`].
    pub fall_back: bool,
}

/// The receiving end of the link.
#[derive(Debug)]
pub struct Session {
    decoder: Decoder,
    broken_frames: u32,
    /// The last request, and its answer when there is one.
    last: Option<(RequestId, Option<Response>)>,
    /// Grows with every greeting.
    conversation: u8,
    /// When the host said something.
    heard: DeviceTime,
    rate: Rate,
}

/// At which rate the line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rate {
    Default,
    /// Another one, at which nothing was heard yet.
    Tried {
        since: DeviceTime,
    },
    /// Another one, which works.
    Works,
}

impl Default for Session {
    fn default() -> Self {
        Self::new()
    }
}

impl Session {
    /// A session that has received nothing.
    pub const fn new() -> Self {
        Self {
            decoder: Decoder::new(),
            broken_frames: 0,
            last: None,
            conversation: 0,
            heard: DeviceTime::from_micros(0),
            rate: Rate::Default,
        }
    }

    /// Takes one byte from the host. A broken frame is counted and otherwise ignored: the host repeats what is not answered.
    #[inline(never)]
    pub fn on_byte(&mut self, byte: u8, now: DeviceTime) -> Option<Order> {
        let Ok(message) = self.decoder.push(byte)? else {
            self.broken_frames = self.broken_frames.wrapping_add(1);
            return None;
        };
        self.heard = now;
        if matches!(self.rate, Rate::Tried { .. }) {
            self.rate = Rate::Works;
        }
        let (id, request) = match message {
            ToDevice::Hello => {
                self.last = None;
                self.conversation = self.conversation.wrapping_add(1);
                return Some(Order::Send(ToHost::Hello(hello())));
            }
            ToDevice::Request(id, request) => (id, request),
        };
        if let Some((last, answer)) = &self.last
            && *last == id
        {
            return answer.clone().map(|answer| Order::Send(ToHost::Response(id, answer)));
        }
        self.last = Some((id, None));
        let ticket = Ticket { id, conversation: self.conversation };
        Some(match request {
            Request::ChangeRate(baud) => Order::ChangeRate(ticket, baud),
            request => Order::Serve(ticket, request),
        })
    }

    /// The message that answers a request; kept, in case that it gets lost. `None` where the conversation that it belongs to is over.
    pub fn answer(&mut self, ticket: Ticket, response: Response) -> Option<ToHost> {
        if ticket.conversation != self.conversation {
            return None;
        }
        if let Some((last, answer)) = &mut self.last
            && *last == ticket.id
        {
            *answer = Some(response.clone());
        }
        Some(ToHost::Response(ticket.id, response))
    }

    /// The line has this rate from now on.
    pub fn rate_changed(&mut self, baud: u32, now: DeviceTime) {
        self.rate = if baud == DEFAULT_BAUD { Rate::Default } else { Rate::Tried { since: now } };
    }

    /// What is to be done now because the host says nothing; to be asked every few milliseconds. A board that falls back says so
    /// by [`Session::rate_changed`].
    pub fn watch(&mut self, now: DeviceTime) -> Silence {
        let is_gone = micros_since(now, self.heard) > HOST_SILENCE_MICROS;
        let fall_back = match self.rate {
            Rate::Default => false,
            Rate::Tried { since } => micros_since(now, since) > RATE_TRIAL_MICROS,
            Rate::Works => is_gone,
        };
        if fall_back {
            // A request for this rate that comes again is a new one.
            self.last = None;
        }
        Silence { end_stream: is_gone, fall_back }
    }

    /// Frames from the host that were broken.
    pub const fn broken_frames(&self) -> u32 {
        self.broken_frames
    }
}

const fn micros_since(now: DeviceTime, earlier: DeviceTime) -> u64 {
    now.as_micros().saturating_sub(earlier.as_micros())
}

/// The greeting of this firmware.
pub const fn hello() -> Hello {
    Hello {
        product: PRODUCT,
        protocol_version: PROTOCOL_VERSION,
        firmware_version: [
            version_part(env!("CARGO_PKG_VERSION_MAJOR")),
            version_part(env!("CARGO_PKG_VERSION_MINOR")),
            version_part(env!("CARGO_PKG_VERSION_PATCH")),
        ],
    }
}

/// Reads a decimal number at compile time.
const fn version_part(text: &str) -> u8 {
    let digits = text.as_bytes();
    let mut value = 0;
    let mut position = 0;
    while position < digits.len() {
        value = value * 10 + (digits[position] - b'0');
        position += 1;
    }
    value
}

#[cfg(test)]
mod tests;
