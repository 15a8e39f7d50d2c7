//! The `ftcal` command.

use std::io;
use std::process::ExitCode;

use clap::Parser;
use ftcal::cli::{self, Cli};
use ftcal::commands::Streams;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let mut data = io::BufWriter::new(io::stdout());
    let mut words = io::stderr();
    cli::run(&cli, &mut Streams { data: &mut data, words: &mut words })
}
