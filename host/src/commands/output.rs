//! Where a command's data goes: to standard output, or to a file that is written completely or not at all.

use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;
use tempfile::NamedTempFile;

use super::Failure;
use crate::recording::shown;

/// A destination that takes data.
pub enum Output<'a> {
    /// A stream, as it comes.
    Stream(&'a mut dyn Write),
    /// A file beside the one asked for, which takes its place in the end.
    File {
        /// Takes the data.
        partial: BufWriter<NamedTempFile>,
        /// The file asked for.
        path: PathBuf,
    },
}

impl<'a> Output<'a> {
    /// Opens the file, or takes the stream where no file is asked for.
    ///
    /// # Errors
    ///
    /// [`Failure::Input`] where no file can be made there.
    pub fn open(path: Option<&Path>, stream: &'a mut dyn Write) -> Result<Self, Failure> {
        let Some(path) = path else { return Ok(Self::Stream(stream)) };
        let directory = match path.parent() {
            Some(directory) if !directory.as_os_str().is_empty() => directory,
            _ => Path::new("."),
        };
        let partial = partial_file().tempfile_in(directory).with_context(|| cannot_write(path))?;
        Ok(Self::File { partial: BufWriter::new(partial), path: path.to_owned() })
    }

    /// Ends the data; only now is the file there.
    ///
    /// # Errors
    ///
    /// [`Failure`]; the file is then not there, or as it was before.
    pub fn finish(self) -> Result<(), Failure> {
        match self {
            Self::Stream(out) => Ok(out.flush()?),
            Self::File { partial, path } => {
                let context = || cannot_write(&path);
                let partial = partial.into_inner().map_err(io::Error::from).with_context(context)?;
                partial.as_file().sync_all().with_context(context)?;
                partial.persist(&path).map_err(|error| error.error).with_context(context)?;
                Ok(())
            }
        }
    }
}

impl Write for Output<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        match self {
            Self::Stream(out) => out.write(bytes),
            Self::File { partial, .. } => partial.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Stream(out) => out.flush(),
            Self::File { partial, .. } => partial.flush(),
        }
    }
}

fn cannot_write(path: &Path) -> String {
    format!("{}: cannot be written", shown(path))
}

/// A file with the permissions that any new file gets; temporary files are closed to others otherwise.
fn partial_file<'a>() -> tempfile::Builder<'a, 'a> {
    let mut builder = tempfile::Builder::new();
    builder.prefix(".ftcal-").suffix(".partial");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    builder
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::io::Write;

    use super::Output;

    #[test]
    fn a_file_is_there_when_it_is_complete_and_not_before() {
        let directory = tempfile::tempdir().expect("a directory");
        let path = directory.path().join("out.csv");
        fs::write(&path, "before").expect("a directory of our own");
        let mut stream = Vec::new();

        let mut output = Output::open(Some(&path), &mut stream).expect("a directory of our own");
        output.write_all(b"half of it").expect("room on the disk");
        drop(output);
        assert_eq!(fs::read_to_string(&path).expect("still there"), "before");

        let mut output = Output::open(Some(&path), &mut stream).expect("a directory of our own");
        output.write_all(b"all of it").expect("room on the disk");
        output.finish().expect("room on the disk");
        assert_eq!(fs::read_to_string(&path).expect("there now"), "all of it");
        assert_eq!(fs::read_dir(directory.path()).expect("a directory").count(), 1, "nothing else is left");
        assert!(stream.is_empty());
    }

    #[test]
    fn a_directory_that_is_not_there_is_an_error() {
        let directory = tempfile::tempdir().expect("a directory");
        assert!(Output::open(Some(&directory.path().join("no/such/out.csv")), &mut Vec::new()).is_err());
    }
}
