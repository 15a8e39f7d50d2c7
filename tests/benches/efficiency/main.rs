//! How close to the best possible the estimator is, and whether it knows: required against measured, as a table.
//!
//! `cargo bench -p ftcal-tests --bench efficiency`. Seeds are fixed. Exits with 1 where a measured row misses its bound.

mod bound;
mod limit;
mod setting;
mod table;

use std::process::ExitCode;

use ftcal_shared::estimation::moments::higher_moment_count;

use crate::limit::{Honesty, error_over_bound, honesty};
use crate::setting::Setting;
use crate::table::{Required, Table};

/// Samples of a trial.
const SAMPLES: usize = 1000;

/// One row: its name, its setting, the largest error over the bound, and the instances of the estimator that measure it.
struct Row {
    name: &'static str,
    setting: Setting,
    most: f64,
    error_over_bound: fn(Setting) -> f64,
    honesty: fn(Setting) -> Honesty,
}

const fn row<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    name: &'static str,
    condition: f64,
    relative_noise: f64,
    most: f64,
) -> Row {
    Row {
        name,
        setting: Setting { condition, relative_noise, samples: SAMPLES },
        most,
        error_over_bound: error_over_bound::<GAGES, HIGHER, RANK>,
        honesty: honesty::<GAGES, HIGHER, RANK>,
    }
}

const P4: usize = higher_moment_count(4);
const P6: usize = higher_moment_count(6);
const P8: usize = higher_moment_count(8);

const ROWS: [Row; 7] = [
    row::<8, P8, 3>("p = 8, r = 3, σ = 0.1 %", 1.0, 0.001, 1.03),
    row::<8, P8, 3>("p = 8, r = 3, σ = 1 %", 1.0, 0.01, 1.03),
    row::<8, P8, 3>("p = 8, r = 3, σ = 5 %", 1.0, 0.05, 1.04),
    row::<8, P8, 3>("p = 8, r = 3, condition 4, σ = 1 %", 4.0, 0.01, 1.12),
    row::<8, P8, 3>("p = 8, r = 3, condition 4, σ = 5 %", 4.0, 0.05, 1.15),
    row::<6, P6, 3>("p = 6, r = 3, condition 4, σ = 5 %", 4.0, 0.05, 1.18),
    row::<4, P4, 2>("p = 4, r = 2, σ = 5 %", 1.0, 0.05, 1.05),
];

fn main() -> ExitCode {
    let mut table = Table::begin();
    for row in &ROWS {
        let name = format!("error ÷ bound, {}", row.name);
        table.measured(&name, Required::AtMost(row.most), (row.error_over_bound)(row.setting));
    }
    for row in &ROWS {
        let honesty = (row.honesty)(row.setting);
        let ratio = Required::Within(0.85, 1.15);
        table.measured(&format!("predicted ÷ observed, least, {}", row.name), ratio, honesty.least_ratio);
        table.measured(&format!("predicted ÷ observed, largest, {}", row.name), ratio, honesty.largest_ratio);
        let covered = 100.0 * honesty.covered;
        table.measured(
            &format!("within 95 % intervals, %, {}", row.name),
            Required::Within(93.0, 97.0),
            covered,
        );
    }
    if table.missed() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}
