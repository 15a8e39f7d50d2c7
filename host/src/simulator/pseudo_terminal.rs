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
    link: Option<PathBuf>,
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
        Ok(Self { board_end, path, link: None })
    }

    /// The path that programs open.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes a symbolic link to the path that programs open, which goes away with the pseudo-terminal. A symbolic link
    /// that is there already is replaced; any other file is not.
    ///
    /// # Errors
    ///
    /// That of the operating system.
    pub fn link_at(&mut self, link: &Path) -> io::Result<()> {
        if link.symlink_metadata().is_ok_and(|there| there.file_type().is_symlink()) {
            std::fs::remove_file(link)?;
        }
        std::os::unix::fs::symlink(&self.path, link)?;
        self.link = Some(link.to_owned());
        Ok(())
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

impl Drop for PseudoTerminal {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            let _ = std::fs::remove_file(link);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread::{self, JoinHandle};
    use std::time::{Duration, Instant};

    use ftcal_shared::units::{DataRate, Gain};
    use ftcal_shared::wire::StreamKind;

    use super::PseudoTerminal;
    use crate::link::client::Client;
    use crate::link::error::{ClientError, LinkError};
    use crate::link::frame::Frame;
    use crate::link::serial::{OpenError, SerialTransport};
    use crate::link::transport::TransportError;
    use crate::simulator::board::SimulatedBoard;
    use crate::simulator::scenario::{Scenario, ScenarioKind};

    /// A board that is served by a thread until dropped.
    struct Served {
        path: String,
        stop: Arc<AtomicBool>,
        thread: Option<JoinHandle<()>>,
    }

    impl Served {
        fn new() -> Self {
            let scenario = Scenario::new(ScenarioKind::Force, 3).expect("sizes fit");
            let mut board = SimulatedBoard::for_scenario(&scenario, 3).expect("sizes fit").into_board();
            let mut terminal = PseudoTerminal::open().expect("a pseudo-terminal");
            let path = terminal.path().display().to_string();
            let stop = Arc::new(AtomicBool::new(false));
            let told = Arc::clone(&stop);
            let serve = move || terminal.serve(board.as_mut(), &told).expect("a second handle");
            Self { path, stop, thread: Some(thread::spawn(serve)) }
        }

        fn client(&self) -> Client<SerialTransport> {
            Client::connect(SerialTransport::open(&self.path).expect("opens")).expect("answers")
        }
    }

    impl Drop for Served {
        fn drop(&mut self) {
            self.stop.store(true, Ordering::Relaxed);
            if let Some(thread) = self.thread.take() {
                thread.join().expect("the server does not panic");
            }
        }
    }

    #[test]
    fn one_client_after_the_other_is_served_in_real_time() {
        let served = Served::new();
        let mut client = served.client();
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

        let mut next = served.client();
        assert_eq!(next.status().expect("answers").stream, StreamKind::Off, "the stream was ended");
        assert_eq!(next.next_frame(Duration::from_millis(50)).expect("the line is sound"), None);
    }

    #[test]
    fn a_port_is_open_for_one_program_and_free_again_when_closed() {
        let served = Served::new();
        let client = served.client();
        assert!(matches!(SerialTransport::open(&served.path), Err(OpenError::InUse { .. })));
        drop(client);
        served.client();
    }

    #[test]
    fn a_program_that_does_not_read_harms_only_itself() {
        let served = Served::new();
        let mut client = served.client();
        client.wait_for_converter().expect("the converter starts");
        client.stream(StreamKind::Codes).expect("answers");
        drop(client);
        // The stream still runs, and overflows what the pseudo-terminal can hold.
        let idle = serialport::new(&served.path, 0).open().expect("opens");
        thread::sleep(Duration::from_millis(300));
        drop(idle);
        served.client().status().expect("answers");
    }

    #[test]
    fn a_port_that_vanishes_is_an_error_and_no_hang() {
        let served = Served::new();
        let mut client = served.client();
        drop(served);
        let begin = Instant::now();
        let error = client.wait(Duration::from_secs(30)).expect_err("the port is gone");
        assert!(matches!(error, ClientError::Link(LinkError::Line(TransportError::Vanished))), "{error}");
        let error = client.status().expect_err("the port is gone");
        assert!(matches!(error, ClientError::Link(LinkError::Line(_))), "{error}");
        assert!(begin.elapsed() < Duration::from_secs(10));
    }

    #[test]
    fn the_link_goes_away_with_the_terminal_and_replaces_only_links() {
        let directory = tempfile::tempdir().expect("a directory");
        let link = directory.path().join("sensor");
        for _ in 0..2 {
            let mut terminal = PseudoTerminal::open().expect("a pseudo-terminal");
            // What a simulator that was killed leaves behind.
            let _ = std::os::unix::fs::symlink("/nowhere", &link);
            terminal.link_at(&link).expect("a directory of our own");
            assert_eq!(std::fs::read_link(&link).expect("a link"), terminal.path());
        }
        assert!(link.symlink_metadata().is_err());
        std::fs::write(&link, "precious").expect("a directory of our own");
        let mut terminal = PseudoTerminal::open().expect("a pseudo-terminal");
        assert!(terminal.link_at(&link).is_err());
        drop(terminal);
        assert_eq!(std::fs::read_to_string(&link).expect("still there"), "precious");
    }

    #[test]
    fn what_is_no_port_is_not_opened() {
        assert!(matches!(SerialTransport::open("/dev/no-such-port"), Err(OpenError::NoSuchPort { .. })));
        assert!(matches!(SerialTransport::open("/dev/null"), Err(OpenError::CannotOpen { .. })));
    }
}
