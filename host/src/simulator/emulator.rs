//! The firmware's image in QEMU, with a converter from the simulator.
//!
//! ```text
//! any program ──pseudo-terminal──► USART3 ┐
//!                                         ├─ emulated image in qemu-system-arm
//! converter, flash, panel ─tunnel► USART2 ┘
//! ```
//!
//! The machine is `netduinoplus2`, which has the STM32F405. The host link is a pseudo-terminal, of which QEMU chooses the
//! name; the tunnel is a socket that QEMU inherits as its standard input, so that no other program can get in between.
//!
//! QEMU notices only after up to a second that a program has opened the pseudo-terminal; what the board sends while none
//! has it open is lost. A program that has it open and does not read stops the board, for the emulated serial port waits.

use std::fs::File;
use std::io::{self, BufRead, BufReader, Write, pipe};
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::{Child, Command};
use std::thread::{self, JoinHandle};

use thiserror::Error;

use super::flash::SimulatedFlash;
use super::panel::SharedPanel;
use super::tunnel::{Pace, TunnelledConverter, serve};

/// The emulator.
const PROGRAM: &str = "qemu-system-arm";

/// What QEMU says when it has made the pseudo-terminal; the name follows.
const ANNOUNCEMENT: &str = "char device redirected to ";

/// Why the image does not run.
#[derive(Debug, Error)]
pub enum EmulatorError {
    /// There is no such file.
    #[error("there is no image {}", path.display())]
    NoImage {
        /// The image as given.
        path: PathBuf,
    },
    /// QEMU is not installed.
    #[error("{PROGRAM} is not installed")]
    NotInstalled,
    /// QEMU does not run this image.
    #[error("{PROGRAM} does not start: {}", words.trim())]
    NotStarting {
        /// What QEMU says.
        words: String,
    },
    /// The operating system refuses a socket, a pipe or a process.
    #[error("{PROGRAM} cannot be started")]
    Failed(#[from] io::Error),
}

/// An emulated board that runs until it is dropped.
pub struct Emulator {
    machine: Child,
    flash: SimulatedFlash,
    panel: SharedPanel,
    link: PathBuf,
    tunnel: Option<JoinHandle<io::Result<()>>>,
    /// Takes what QEMU says until it ends.
    words: Option<JoinHandle<io::Result<u64>>>,
}

impl Emulator {
    /// Starts the emulated image with this converter, and with a flash as it comes from the factory.
    ///
    /// # Errors
    ///
    /// [`EmulatorError`].
    pub fn start(
        image: &Path,
        converter: impl TunnelledConverter + Send + 'static,
        pace: Pace,
    ) -> Result<Self, EmulatorError> {
        Self::start_with_flash(image, converter, SimulatedFlash::default(), pace)
    }

    /// Starts the emulated image with this converter and this flash. To end the emulator is to cut its power.
    ///
    /// # Errors
    ///
    /// [`EmulatorError`].
    pub fn start_with_flash(
        image: &Path,
        converter: impl TunnelledConverter + Send + 'static,
        flash: SimulatedFlash,
        pace: Pace,
    ) -> Result<Self, EmulatorError> {
        Self::start_with(image, converter, flash, pace, None)
    }

    /// The same; what the image logs goes to the file `logs`, if there is one.
    ///
    /// # Errors
    ///
    /// [`EmulatorError`].
    pub fn start_with(
        image: &Path,
        mut converter: impl TunnelledConverter + Send + 'static,
        flash: SimulatedFlash,
        pace: Pace,
        logs: Option<&Path>,
    ) -> Result<Self, EmulatorError> {
        if !image.is_file() {
            return Err(EmulatorError::NoImage { path: image.to_owned() });
        }
        let (our_end, board_end) = UnixStream::pair()?;
        let (words, told) = pipe()?;
        // The command keeps handles of its own until it is dropped: of the socket and of the pipe, whose ends tell us.
        let machine = {
            let mut command = Command::new(PROGRAM);
            command
                .args(["-machine", "netduinoplus2", "-kernel"])
                .arg(image)
                .args(["-display", "none", "-monitor", "none"])
                .args(["-chardev", &log_device(logs)])
                .args(["-semihosting-config", "enable=on,target=native,chardev=logs"])
                .args(["-chardev", "socket,id=tunnel,fd=0"])
                .args(["-serial", "null", "-serial", "chardev:tunnel", "-serial", "pty"])
                .stdin(OwnedFd::from(board_end))
                .stdout(told.try_clone()?)
                .stderr(told);
            command.spawn()
        };
        let machine = machine.map_err(|error| match error.kind() {
            io::ErrorKind::NotFound => EmulatorError::NotInstalled,
            _ => EmulatorError::Failed(error),
        })?;
        // From here on the machine is stopped whatever happens.
        let mut board_flash = flash.clone();
        let panel = SharedPanel::default();
        let board_panel = panel.clone();
        let mut emulator = Self { machine, flash, panel, link: PathBuf::new(), tunnel: None, words: None };
        let mut words = BufReader::new(words);
        emulator.link = link_path(&mut words)?;
        // QEMU before version 8 has the image's log follow its own words, whatever device the log was given.
        let mut log: Box<dyn Write + Send> = match logs {
            Some(path) => Box::new(File::options().create(true).append(true).open(path)?),
            None => Box::new(io::sink()),
        };
        emulator.words = Some(thread::spawn(move || io::copy(&mut words, &mut log)));
        let reader = our_end.try_clone()?;
        emulator.tunnel = Some(thread::spawn(move || {
            serve(reader, our_end, &mut converter, &mut board_flash, &board_panel, pace)
        }));
        Ok(emulator)
    }

    /// The board's button and light.
    pub fn panel(&self) -> SharedPanel {
        self.panel.clone()
    }

    /// The board's serial port, for any program to open.
    pub fn link(&self) -> &Path {
        &self.link
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.flash.cut_power();
        // Neither fails but where the machine has ended already, which is what is wanted.
        let _ = self.machine.kill();
        let _ = self.machine.wait();
        if let Some(tunnel) = self.tunnel.take() {
            // The socket is closed with the machine, which ends the tunnel.
            let _ = tunnel.join();
        }
        if let Some(words) = self.words.take() {
            // The pipe is closed with the machine, too.
            let _ = words.join();
        }
    }
}

/// What QEMU makes of the log. It takes a comma for the end of a name, and two for a comma in it.
fn log_device(logs: Option<&Path>) -> String {
    logs.map_or("null,id=logs".to_owned(), |path| {
        format!("file,id=logs,path={}", path.display().to_string().replace(',', ",,"))
    })
}

/// Reads what QEMU says until it names the pseudo-terminal. Ends with the machine at the latest.
fn link_path(words: &mut impl BufRead) -> Result<PathBuf, EmulatorError> {
    let mut said = String::new();
    for line in words.lines() {
        let line = line?;
        if let Some(rest) = line.strip_prefix(ANNOUNCEMENT) {
            let name = rest.split_once(" (label").map_or(rest, |(name, _)| name);
            return Ok(PathBuf::from(name));
        }
        said.push_str(&line);
        said.push('\n');
    }
    Err(EmulatorError::NotStarting { words: said })
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::{EmulatorError, link_path};

    #[test]
    fn the_link_is_what_qemu_says_it_is() {
        let words = "a warning\nchar device redirected to /dev/pts/7 (label serial2)\n";
        assert_eq!(link_path(&mut words.as_bytes()).unwrap(), PathBuf::from("/dev/pts/7"));
    }

    #[test]
    fn an_emulator_that_ends_without_a_link_is_quoted() {
        let error = link_path(&mut "could not load kernel\n".as_bytes()).unwrap_err();
        assert!(matches!(&error, EmulatorError::NotStarting { words } if words == "could not load kernel\n"));
    }
}
