//! A serial port, or a pseudo-terminal, as a line to the sensor.
//!
//! A read on a serial port can outlast its time-out: some drivers do not honour it, and a port that is pulled out in the middle of
//! a read may never come back. Nobody waits for the port here but a thread of its own. It passes on what it reads through a channel,
//! and the client waits on the channel, whose deadline holds whatever the port does. Each piece bears the time at which it came, so that
//! nothing is taken for new because the client was late to look. When the port fails, the thread passes that on and ends;
//! everything read before comes first.

use std::io::{self, Read, Write};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use ftcal_firmware::baud::DEFAULT_BAUD;
use serialport::SerialPort;
use thiserror::Error;

use super::transport::{Transport, TransportError};

/// How long one read of the reader thread is meant to last, and one write at most.
const PORT_TIMEOUT: Duration = Duration::from_millis(50);
/// How long a write may go on without the port taking a byte.
const STALL: Duration = Duration::from_secs(1);
/// How long closing waits for the reader thread; a thread that hangs in its port is left to itself.
const CLOSING: Duration = Duration::from_millis(500);
/// Bytes taken from the port at once: about 40 ms of the line at full load.
const CHUNK: usize = 4096;
/// Chunks that wait for the client; beyond them the bytes wait in the operating system's buffer, or are lost there.
const CHUNKS: usize = 65_536;

/// Why a port is not opened.
#[derive(Debug, Error)]
pub enum OpenError {
    /// There is no such port, or the device behind it is gone.
    #[error("there is no serial port {path}")]
    NoSuchPort {
        /// The port as given.
        path: String,
    },
    /// The user may not open it.
    #[error("you are not permitted to open the serial port {path}")]
    NotPermitted {
        /// The port as given.
        path: String,
    },
    /// Somebody else has it open.
    #[error("the serial port {path} is in use by another program")]
    InUse {
        /// The port as given.
        path: String,
    },
    /// It is no serial port, or its driver refuses the settings.
    #[error("{path} cannot be opened as a serial port: {cause}")]
    CannotOpen {
        /// The port as given.
        path: String,
        /// What the operating system says.
        cause: serialport::Error,
    },
}

impl OpenError {
    fn new(path: &str, cause: serialport::Error) -> Self {
        let path = path.to_owned();
        match cause.kind() {
            serialport::ErrorKind::Io(io::ErrorKind::PermissionDenied) => Self::NotPermitted { path },
            // The `serialport` crate has one kind for a lock that somebody holds and for a device that is not there.
            serialport::ErrorKind::NoDevice if Path::new(&path).exists() => Self::InUse { path },
            serialport::ErrorKind::NoDevice | serialport::ErrorKind::Io(io::ErrorKind::NotFound) => {
                Self::NoSuchPort { path }
            }
            _ => Self::CannotOpen { path, cause },
        }
    }
}

/// What the port had to read at one time, or that it failed.
type Piece = io::Result<(Instant, Vec<u8>)>;

/// An open serial port.
pub struct SerialTransport {
    port: Box<dyn SerialPort>,
    received: Receiver<Piece>,
    closing: Arc<AtomicBool>,
    opened: Instant,
}

impl SerialTransport {
    /// Opens this port at [`DEFAULT_BAUD`] and throws away what it received before. Nobody else can open it meanwhile.
    ///
    /// # Errors
    ///
    /// [`OpenError`].
    pub fn open(path: &str) -> Result<Self, OpenError> {
        let cannot_open = |cause| OpenError::new(path, cause);
        let builder = serialport::new(path, DEFAULT_BAUD).timeout(PORT_TIMEOUT);
        let port = open_locked(&builder).map_err(cannot_open)?;
        port.clear(serialport::ClearBuffer::Input).map_err(cannot_open)?;
        Self::over(port).map_err(cannot_open)
    }

    /// Starts the reader thread, with a handle of its own.
    fn over(port: Box<dyn SerialPort>) -> serialport::Result<Self> {
        let reader = port.try_clone()?;
        let closing = Arc::new(AtomicBool::new(false));
        let (sender, received) = sync_channel(CHUNKS);
        let told_to_close = Arc::clone(&closing);
        let opened = Instant::now();
        thread::spawn(move || pass_on(reader, &sender, &told_to_close));
        Ok(Self { port, received, closing, opened })
    }
}

/// Opens a port for this process alone.
///
/// Of the two locks that the `serialport` crate takes, the file lock is kept and the terminal's exclusive mode given
/// back: a process that is killed leaves the mode behind, and on a pseudo-terminal nobody could ever open it again.
#[cfg(unix)]
fn open_locked(builder: &serialport::SerialPortBuilder) -> serialport::Result<Box<dyn SerialPort>> {
    let mut port = builder.clone().open_native()?;
    port.set_exclusive(false)?;
    Ok(Box::new(port))
}

/// Opens a port, which elsewhere than on Unix is always for this process alone.
#[cfg(not(unix))]
fn open_locked(builder: &serialport::SerialPortBuilder) -> serialport::Result<Box<dyn SerialPort>> {
    builder.clone().open()
}

/// The reader thread.
fn pass_on(mut port: Box<dyn SerialPort>, sender: &SyncSender<Piece>, closing: &AtomicBool) {
    let mut chunk = [0; CHUNK];
    while !closing.load(Ordering::Relaxed) {
        let passed = match port.read(&mut chunk) {
            Ok(0) => Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(length) => Ok((Instant::now(), chunk.iter().take(length).copied().collect())),
            Err(error) if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {
                continue;
            }
            Err(error) => Err(error),
        };
        let ended = passed.is_err();
        if sender.send(passed).is_err() || ended {
            return;
        }
    }
}

impl Transport for SerialTransport {
    fn write(&mut self, bytes: &[u8]) -> Result<(), TransportError> {
        let mut rest = bytes;
        let mut last_taken = Instant::now();
        while !rest.is_empty() {
            match self.port.write(rest) {
                Ok(taken) if taken > 0 => {
                    rest = rest.get(taken..).unwrap_or_default();
                    last_taken = Instant::now();
                }
                Ok(_) => {}
                Err(error)
                    if matches!(error.kind(), io::ErrorKind::TimedOut | io::ErrorKind::Interrupted) => {}
                Err(error) => return Err(failure(error)),
            }
            if last_taken.elapsed() > STALL {
                return Err(TransportError::Stalled);
            }
        }
        Ok(())
    }

    fn read(&mut self, received: &mut Vec<u8>, deadline: Duration) -> Result<Duration, TransportError> {
        match self.received.recv_timeout(deadline.saturating_sub(self.elapsed())) {
            Ok(Ok((came, bytes))) => {
                received.extend_from_slice(&bytes);
                Ok(came.saturating_duration_since(self.opened))
            }
            Ok(Err(error)) => Err(failure(error)),
            Err(RecvTimeoutError::Timeout) => Ok(self.elapsed()),
            Err(RecvTimeoutError::Disconnected) => Err(TransportError::Vanished),
        }
    }

    fn elapsed(&self) -> Duration {
        self.opened.elapsed()
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), TransportError> {
        self.port.set_baud_rate(baud).map_err(|_| TransportError::NoSuchRate { baud })
    }
}

/// What it means that an open port fails. A device that is pulled out shows itself as almost any error, which the
/// `serialport` crate reports without its number.
fn failure(error: io::Error) -> TransportError {
    match error.kind() {
        io::ErrorKind::BrokenPipe
        | io::ErrorKind::UnexpectedEof
        | io::ErrorKind::NotFound
        | io::ErrorKind::Other => TransportError::Vanished,
        _ => TransportError::Failed(error),
    }
}

impl Drop for SerialTransport {
    /// Ends the reader thread, so that the port can be opened again.
    fn drop(&mut self) {
        self.closing.store(true, Ordering::Relaxed);
        let deadline = Instant::now() + CLOSING;
        loop {
            let wait = deadline.saturating_duration_since(Instant::now());
            match self.received.recv_timeout(wait) {
                Ok(_) if !wait.is_zero() => {}
                _ => return,
            }
        }
    }
}

#[cfg(all(unix, test))]
mod tests {
    use std::io::Write;
    use std::thread;
    use std::time::Duration;

    use serialport::{SerialPort, TTYPort};

    use super::{PORT_TIMEOUT, SerialTransport};
    use crate::link::transport::Transport;

    #[test]
    fn each_piece_bears_the_time_at_which_it_came() {
        const APART: Duration = Duration::from_millis(300);
        let (mut board_end, mut program_end) = TTYPort::pair().expect("a pseudo-terminal");
        program_end.set_timeout(PORT_TIMEOUT).expect("an open port");
        let mut line = SerialTransport::over(Box::new(program_end)).expect("a second handle");
        for byte in [1, 2] {
            board_end.write_all(&[byte]).expect("an open port");
            thread::sleep(APART);
        }
        let mut received = Vec::new();
        let first = line.read(&mut received, Duration::ZERO).expect("an open port");
        assert_eq!(received, [1]);
        let second = line.read(&mut received, Duration::ZERO).expect("an open port");
        assert_eq!(received, [1, 2]);
        // A busy machine notices both later, and the sleeps are no shorter than asked for.
        assert!(second > first + APART / 2, "{first:?} {second:?}");
        assert!(line.elapsed() > first + APART, "{first:?}");
        line.read(&mut received, Duration::ZERO).expect("an open port");
        assert_eq!(received.len(), 2, "nothing has come since");
    }
}
