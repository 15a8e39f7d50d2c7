//! The table: what is required beside what was measured.

use std::fmt;

/// Where a measured number must lie.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Required {
    /// At most this.
    AtMost(f64),
    /// At least this.
    AtLeast(f64),
    /// Between these.
    Within(f64, f64),
}

impl Required {
    fn is_met(self, measured: f64) -> bool {
        match self {
            Self::AtMost(most) => measured <= most,
            Self::AtLeast(least) => measured >= least,
            Self::Within(least, most) => (least..=most).contains(&measured),
        }
    }
}

impl fmt::Display for Required {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AtMost(most) => write!(out, "≤ {most}"),
            Self::AtLeast(least) => write!(out, "≥ {least}"),
            Self::Within(least, most) => write!(out, "{least} to {most}"),
        }
    }
}

/// Prints rows as they come, in Markdown, and remembers whether any missed its bound.
#[derive(Debug, Default)]
pub(crate) struct Table {
    missed: usize,
}

impl Table {
    /// Prints the head.
    pub(crate) fn begin() -> Self {
        println!("| quantity | required | measured | |");
        println!("|---|---|---|---|");
        Self::default()
    }

    /// A row that was measured.
    pub(crate) fn measured(&mut self, quantity: &str, required: Required, measured: f64) {
        let verdict = if required.is_met(measured) {
            "met"
        } else {
            self.missed += 1;
            "**missed**"
        };
        println!("| {quantity} | {required} | {measured:.3} | {verdict} |");
    }

    /// A number beside the others, of which nothing is required.
    pub(crate) fn noted(quantity: &str, measured: f64) {
        // Errors of a wrench are small, ratios of them are not.
        if measured.abs() < 0.1 && measured != 0.0 {
            println!("| {quantity} | | {measured:.2e} | |");
        } else {
            println!("| {quantity} | | {measured:.3} | |");
        }
    }

    /// A row for which there is nothing to measure yet.
    pub(crate) fn not_measured(quantity: &str, required: Required, missing: &str) {
        println!("| {quantity} | {required} | not measured: {missing} | |");
    }

    /// How many of the measured rows missed their bound.
    pub(crate) const fn missed(&self) -> usize {
        self.missed
    }
}

/// The number in the middle; not a number of none.
pub(crate) fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers.get(numbers.len() / 2).copied().unwrap_or(f64::NAN)
}
