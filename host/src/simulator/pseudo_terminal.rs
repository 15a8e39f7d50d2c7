//! A simulated board behind a pseudo-terminal, so that every program that opens serial ports can talk to it.
//!
//! The board lives in real time here: as many conversions as the clock says. A machine that is too slow for that makes
//! the board's clock slow; no conversion is skipped. As on a real line, what nobody reads is lost: bytes are thrown away
//! while no program has the port open, and when one has it open and does not read.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};

use super::board::Board;

/// Time between two looks at the line: what a request waits for its answer at most, beside the line itself.
const TURN: Duration = Duration::from_millis(1);
/// How long a program that reads slowly may hold up one piece of output before it is lost.
const WRITING: Duration = Duration::from_millis(100);
/// How far the board may lag behind the clock before it gives up catching up.
const LARGEST_LAG: Duration = Duration::from_millis(250);
/// Pieces of output that wait for a program that reads slowly, one a [`TURN`].
const PIECES: usize = 500;
/// Bytes taken from the line at once.
const CHUNK: usize = 1024;

/// The two ends of a pseudo-terminal: the board's, and the path of the one that programs open.
pub struct PseudoTerminal {
    board_end: TTYPort,
    path: PathBuf,
}

impl PseudoTerminal {
    /// Makes a pseudo-terminal.
    ///
    /// # Errors
    ///
    /// That of the operating system.
    pub fn open() -> io::Result<Self> {
        let (mut board_end, program_end) = TTYPort::pair()?;
        board_end.set_timeout(TURN)?;
        let path = program_end.name().map(PathBuf::from);
        let path = path.ok_or_else(|| io::Error::other("the pseudo-terminal has no name"))?;
        Ok(Self { board_end, path })
    }

    /// The path that programs open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Lets the board live, in real time, until told to stop.
    ///
    /// # Errors
    ///
    /// That of the operating system, where it gives no second handle for writing.
    pub fn serve(&mut self, board: &mut dyn Board, stop: &AtomicBool) -> io::Result<()> {
        let mut writing_end = self.board_end.try_clone_native()?;
        writing_end.set_timeout(WRITING)?;
        let (pieces, to_write) = sync_channel(PIECES);
        // Not waited for in the end: a program that does not read may hold it up for ever.
        thread::spawn(move || write_pieces(writing_end, &to_write));
        self.live(board, &pieces, stop);
        Ok(())
    }

    fn live(&mut self, board: &mut dyn Board, pieces: &SyncSender<Vec<u8>>, stop: &AtomicBool) {
        let mut begin = Instant::now();
        let offset = Duration::from_micros(board.now().as_micros());
        let mut chunk = [0; CHUNK];
        while !stop.load(Ordering::Relaxed) {
            let somebody_there = match self.board_end.read(&mut chunk) {
                Ok(length) => {
                    board.receive(chunk.get(..length).unwrap_or_default());
                    true
                }
                Err(error) if error.kind() == io::ErrorKind::TimedOut => true,
                // No program has the port open.
                Err(_) => {
                    thread::sleep(TURN);
                    false
                }
            };
            let lived =
                |board: &dyn Board| Duration::from_micros(board.now().as_micros()).saturating_sub(offset);
            let turn = Instant::now();
            while lived(board) < begin.elapsed() && turn.elapsed() < LARGEST_LAG {
                board.advance();
            }
            let lag = begin.elapsed().saturating_sub(lived(board));
            if lag > LARGEST_LAG {
                begin += lag;
            }
            let mut piece = Vec::new();
            board.take_sent(&mut piece);
            if somebody_there && !piece.is_empty() {
                // Where the program does not read, the piece is lost.
                let _ = pieces.try_send(piece);
            }
        }
    }
}

/// The writer thread, which may be held up by a program that does not read.
fn write_pieces(mut end: TTYPort, to_write: &Receiver<Vec<u8>>) {
    for piece in to_write {
        // Where the program has closed the port, the piece is lost.
        let _ = end.write_all(&piece);
    }
}

/// A second, stable name for a port, which goes away when dropped.
pub struct PortLink {
    at: PathBuf,
}

impl PortLink {
    /// Makes a symbolic link to this port. A symbolic link that is there already is replaced; any other file is not.
    ///
    /// # Errors
    ///
    /// That of the operating system.
    pub fn new(port: &Path, at: &Path) -> io::Result<Self> {
        if at.symlink_metadata().is_ok_and(|there| there.file_type().is_symlink()) {
            std::fs::remove_file(at)?;
        }
        std::os::unix::fs::symlink(port, at)?;
        Ok(Self { at: at.to_owned() })
    }
}

impl Drop for PortLink {
    fn drop(&mut self) {
        // Somebody else may have taken it away already.
        let _ = std::fs::remove_file(&self.at);
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;
    use std::thread;
    use std::time::{Duration, Instant};

    use ftcal_shared::units::{DataRate, Gain};
    use ftcal_shared::wire::StreamKind;

    use super::PortLink;
    use crate::link::client::Client;
    use crate::link::error::{ClientError, LinkError};
    use crate::link::frame::Frame;
    use crate::link::serial::{OpenError, SerialTransport};
    use crate::link::transport::TransportError;
    use crate::simulator::scenario::ScenarioKind;
    use crate::simulator::served_board::ServedBoard;

    fn connected_to(board: &ServedBoard) -> Client<SerialTransport> {
        Client::connect(SerialTransport::open(&board.path).expect("opens")).expect("answers")
    }

    #[test]
    fn one_client_after_the_other_is_served_in_real_time() {
        let board = ServedBoard::new(ScenarioKind::Force);
        let mut client = connected_to(&board);
        client.configure_adc(DataRate::Hz500, Gain::X128).expect("the converter starts");
        client.stream(StreamKind::Codes).expect("answers");
        let begin = Instant::now();
        for _ in 0..100 {
            let frame = client.next_frame(Duration::from_secs(5)).expect("the line is sound");
            assert!(matches!(frame, Some(Frame::Codes(_))));
        }
        // 100 conversions last 200 ms; the first may be one that came before the clock was read.
        assert!(begin.elapsed() > Duration::from_millis(150), "{:?}", begin.elapsed());
        drop(client);

        let mut next = connected_to(&board);
        assert_eq!(next.status().expect("answers").stream, StreamKind::Off, "the stream was ended");
        assert_eq!(next.next_frame(Duration::from_millis(50)).expect("the line is sound"), None);
    }

    #[test]
    fn a_port_is_open_for_one_program_and_free_again_when_closed() {
        let board = ServedBoard::new(ScenarioKind::Force);
        let client = connected_to(&board);
        assert!(matches!(SerialTransport::open(&board.path), Err(OpenError::InUse { .. })));
        drop(client);
        connected_to(&board);
    }

    #[test]
    fn a_program_that_does_not_read_harms_only_itself() {
        let board = ServedBoard::new(ScenarioKind::Force);
        let mut client = connected_to(&board);
        client.wait_for_converter().expect("the converter starts");
        client.stream(StreamKind::Codes).expect("answers");
        drop(client);
        // The stream still runs, and overflows what the pseudo-terminal can hold.
        let idle = serialport::new(&board.path, 0).open().expect("opens");
        thread::sleep(Duration::from_millis(300));
        drop(idle);
        connected_to(&board).status().expect("answers");
    }

    #[test]
    fn a_port_that_vanishes_is_an_error_and_no_hang() {
        let board = ServedBoard::new(ScenarioKind::Force);
        let mut client = connected_to(&board);
        drop(board);
        let begin = Instant::now();
        let error = client.wait(Duration::from_secs(30)).expect_err("the port is gone");
        assert!(matches!(error, ClientError::Link(LinkError::Line(TransportError::Vanished))), "{error}");
        let error = client.status().expect_err("the port is gone");
        assert!(matches!(error, ClientError::Link(LinkError::Line(_))), "{error}");
        assert!(begin.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn a_link_goes_away_in_the_end_and_replaces_only_links() {
        let directory = tempfile::tempdir().expect("a directory");
        let at = directory.path().join("sensor");
        let port = Path::new("/dev/pts/0");
        // What a simulator that was killed leaves behind.
        std::os::unix::fs::symlink("/nowhere", &at).expect("a directory of our own");
        let link = PortLink::new(port, &at).expect("a directory of our own");
        assert_eq!(std::fs::read_link(&at).expect("a link"), port);
        drop(link);
        assert!(at.symlink_metadata().is_err());
        std::fs::write(&at, "precious").expect("a directory of our own");
        assert!(PortLink::new(port, &at).is_err());
        assert_eq!(std::fs::read_to_string(&at).expect("still there"), "precious");
    }

    #[test]
    fn what_is_no_port_is_not_opened() {
        assert!(matches!(SerialTransport::open("/dev/no-such-port"), Err(OpenError::NoSuchPort { .. })));
        assert!(matches!(SerialTransport::open("/dev/null"), Err(OpenError::CannotOpen { .. })));
    }
}
