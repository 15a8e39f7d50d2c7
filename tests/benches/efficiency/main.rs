//! How close to the best possible the estimator is, and whether it knows: required against measured, as a table.
//!
//! `cargo bench -p ftcal-tests --bench efficiency`. Seeds are fixed. Exits with 1 where a measured row misses its bound.

mod bound;
mod degenerate;
mod limit;
mod refined;
mod setting;
mod table;

use std::process::ExitCode;

use ftcal_shared::estimation::moments::higher_moment_count;

use crate::degenerate::{MOTIONS, Motion, Outcome, case};
use crate::limit::{Honesty, error_over_bound, honesty};
use crate::refined::{RefinedError, refined_error, refined_honesty};
use crate::setting::Setting;
use crate::table::{Required, Table};

/// Samples of a trial.
const SAMPLES: usize = 1000;

/// One row: its name, its setting, the largest error over the bound (on the device and, where asked for, refined), and the instances of the
/// estimator that measure it.
struct Row {
    name: &'static str,
    setting: Setting,
    most: f64,
    most_refined: Option<f64>,
    error_over_bound: fn(Setting) -> f64,
    honesty: fn(Setting) -> Honesty,
    refined_error: fn(Setting) -> RefinedError,
    refined_honesty: fn(Setting) -> Honesty,
}

const fn row<const GAGES: usize, const HIGHER: usize, const RANK: usize>(
    name: &'static str,
    condition: f64,
    relative_noise: f64,
    most: f64,
    most_refined: Option<f64>,
) -> Row {
    Row {
        name,
        setting: Setting { condition, relative_noise, samples: SAMPLES },
        most,
        most_refined,
        error_over_bound: error_over_bound::<GAGES, HIGHER, RANK>,
        honesty: honesty::<GAGES, HIGHER, RANK>,
        refined_error: refined_error::<GAGES, RANK>,
        refined_honesty: refined_honesty::<GAGES, RANK>,
    }
}

const P4: usize = higher_moment_count(4);
const P6: usize = higher_moment_count(6);
const P8: usize = higher_moment_count(8);

const ROWS: [Row; 7] = [
    row::<8, P8, 3>("p = 8, r = 3, σ = 0.1 %", 1.0, 0.001, 1.03, None),
    row::<8, P8, 3>("p = 8, r = 3, σ = 1 %", 1.0, 0.01, 1.03, None),
    row::<8, P8, 3>("p = 8, r = 3, σ = 5 %", 1.0, 0.05, 1.04, None),
    row::<8, P8, 3>("p = 8, r = 3, condition 4, σ = 1 %", 4.0, 0.01, 1.12, Some(1.04)),
    row::<8, P8, 3>("p = 8, r = 3, condition 4, σ = 5 %", 4.0, 0.05, 1.15, None),
    row::<6, P6, 3>("p = 6, r = 3, condition 4, σ = 5 %", 4.0, 0.05, 1.18, None),
    row::<4, P4, 2>("p = 4, r = 2, σ = 5 %", 1.0, 0.05, 1.05, None),
];

/// Cases of motions that determine the answer hardly or not at all.
const DEGENERATE_CASES: u64 = 2000;

const P3: usize = higher_moment_count(3);

/// The instances that the degenerate cases go round.
const DEGENERATE: [fn(Motion, u64) -> Outcome; 6] = [
    case::<8, P8, 3>,
    case::<6, P6, 3>,
    case::<4, P4, 3>,
    case::<3, P3, 3>,
    case::<8, P8, 2>,
    case::<4, P4, 2>,
];

/// Numbers of joint fusion and of the gate, none of which can be called yet.
const NOT_MEASURED: [(&str, Required, &str); 6] = [
    ("wrench error, staged ÷ joint, σ = 0.2 %, arms 5 and 15 cm", Required::AtLeast(4.0), "no joint fusion"),
    ("joint with rough directions (30° off), right of 500", Required::AtLeast(500.0), "no joint fusion"),
    ("wrong answers, degenerate arms and loads", Required::AtMost(0.0), "no joint fusion"),
    ("real recording that never rests: sensitivities off by, %", Required::AtMost(2.0), "no gate"),
    ("the same: scatter of the samples used", Required::AtMost(0.03), "no gate"),
    ("a fifth at rest, 2 % disturbance while moving: error ÷ undisturbed", Required::AtMost(1.5), "no gate"),
];

fn main() -> ExitCode {
    let mut table = Table::begin();
    for row in &ROWS {
        let name = format!("error ÷ bound, {}", row.name);
        table.measured(&name, Required::AtMost(row.most), (row.error_over_bound)(row.setting));
    }
    for row in &ROWS {
        measure_honesty(&mut table, row.name, (row.honesty)(row.setting));
    }
    for row in &ROWS {
        let error = (row.refined_error)(row.setting);
        if let Some(most) = row.most_refined {
            let name = format!("refined, error ÷ bound, {}", row.name);
            table.measured(&name, Required::AtMost(most), error.over_bound);
        }
        let name = format!("refined, error ÷ that of the device, {}", row.name);
        table.measured(&name, Required::AtMost(1.0), error.over_start);
    }
    for row in &ROWS {
        let name = format!("refined, {}", row.name);
        measure_honesty(&mut table, &name, (row.refined_honesty)(row.setting));
    }
    let (mut refused, mut wrong) = (0, 0);
    let cases = MOTIONS
        .into_iter()
        .cycle()
        .zip(DEGENERATE.into_iter().flat_map(|instance| [instance; MOTIONS.len()]).cycle());
    for (seed, (motion, instance)) in (0..DEGENERATE_CASES).zip(cases) {
        match instance(motion, seed) {
            Outcome::Refused => refused += 1,
            Outcome::Right => {}
            Outcome::Wrong => {
                wrong += 1;
                eprintln!("wrong answer: seed {seed}, {motion:?}");
            }
        }
    }
    let name = format!("wrong answers of {DEGENERATE_CASES} degenerate motions ({refused} refused)");
    table.measured(&name, Required::AtMost(0.0), f64::from(wrong));
    for (quantity, required, missing) in NOT_MEASURED {
        Table::not_measured(quantity, required, missing);
    }
    if table.missed() == 0 { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn measure_honesty(table: &mut Table, name: &str, honesty: Honesty) {
    let ratio = Required::Within(0.85, 1.15);
    table.measured(&format!("predicted ÷ observed, least, {name}"), ratio, honesty.least_ratio);
    table.measured(&format!("predicted ÷ observed, largest, {name}"), ratio, honesty.largest_ratio);
    let covered = Required::Within(93.0, 97.0);
    table.measured(&format!("within 95 % intervals, %, {name}"), covered, 100.0 * honesty.covered);
}
