//! The sensor's log: what its firmware says of itself, which travels as numbers and is put into words here, with the strings
//! that are kept in the image.
//!
//! On the board the numbers go through memory to the debug probe (RTT), in the emulator to a file. Either way they are a
//! stream of bytes without a beginning; after bytes that were lost, the decoder finds the next message.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use defmt_decoder::{DecodeError, StreamDecoder, Table};

use crate::recording::shown;

/// Why a log cannot be put into words.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The image cannot be read.
    #[error("{file}: cannot be read: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// What the system said.
        reason: io::Error,
    },
    /// It holds no strings.
    #[error("{file}: expected the firmware image (ELF) that the sensor runs, with its log strings: {reason}")]
    NoStrings {
        /// The file.
        file: String,
        /// What is wrong with it.
        reason: String,
    },
}

/// The strings of one image.
pub struct LogStrings {
    table: Table,
}

/// What has become of the bytes taken in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Decoded {
    /// Messages put into words.
    pub messages: u64,
    /// Messages that arrived damaged, or belong to another image.
    pub damaged: u64,
}

impl LogStrings {
    /// Reads the strings of the image that the sensor runs.
    ///
    /// # Errors
    ///
    /// [`LogError`].
    pub fn read(image: &Path) -> Result<Self, LogError> {
        let file = shown(image);
        let elf = std::fs::read(PathBuf::from(image))
            .map_err(|reason| LogError::Unreadable { file: file.clone(), reason })?;
        Self::of_image(&elf, file)
    }

    fn of_image(elf: &[u8], file: String) -> Result<Self, LogError> {
        match Table::parse(elf) {
            Ok(Some(table)) => Ok(Self { table }),
            Ok(None) => Err(LogError::NoStrings { file, reason: "there are none in it".to_owned() }),
            Err(reason) => Err(LogError::NoStrings { file, reason: reason.to_string() }),
        }
    }

    /// A reader at the start of a log.
    pub fn reader(&self) -> LogReader<'_> {
        LogReader { decoder: self.table.new_stream_decoder(), recovers: self.table.encoding().can_recover() }
    }
}

/// Puts a log into words as it comes.
pub struct LogReader<'a> {
    decoder: Box<dyn StreamDecoder + Send + Sync + 'a>,
    recovers: bool,
}

impl LogReader<'_> {
    /// Takes in bytes and writes a line for each message that is complete.
    ///
    /// # Errors
    ///
    /// Those of the destination.
    pub fn take_in(&mut self, bytes: &[u8], out: &mut dyn Write) -> io::Result<Decoded> {
        self.decoder.received(bytes);
        let mut decoded = Decoded::default();
        loop {
            match self.decoder.decode() {
                Ok(frame) => {
                    decoded.messages += 1;
                    writeln!(out, "{}", frame.display(false))?;
                }
                Err(DecodeError::UnexpectedEof) => return Ok(decoded),
                Err(DecodeError::Malformed) => {
                    decoded.damaged += 1;
                    if !self.recovers {
                        return Ok(decoded);
                    }
                }
            }
        }
    }
}
