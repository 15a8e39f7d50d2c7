//! A new trial in the frame of the calibration that there is, with nothing known of the load (design § 8).
//!
//! A trial tells its shape Ŝ (r × p, counts per unit load) up to a turn and a mirror image, and, where nobody says what hangs on the
//! sensor, up to a scale. The stored calibration C (r × p) tells S₀ = (CCᵀ)⁻¹C, counts per newton. What brings one onto the other,
//!
//! ```text
//! min over orthogonal R and s > 0 of Σ_k w_k ‖s R ŝ_k − s₀_k‖²        ŝ_k, s₀_k: column k, of gage k
//! ```
//!
//! is R = UVᵀ, s = tr Σ / Σ w_k‖ŝ_k‖², with Σ w_k s₀_k ŝ_kᵀ = UΣVᵀ (Schönemann 1966). One-sided Jacobi rotations (Hestenes) decompose
//! that matrix, which is r × r: they are short, and accurate where it is nearly singular.
//!
//! **Weights.** Gages drift one by one. Least squares would spread what one of them does over the turn and the scale, and so over all
//! the others: a gage that answers 1 % more takes with it a scale of 1 %/p. So a gage that is off by more than it may be, 2τ_k, pulls
//! no stronger than one that is off by that (Huber): w_k = 1/τ_k² · min(1, 2τ_k/‖s R ŝ_k − s₀_k‖), found by repetition. τ_k is the standard
//! deviation of the column as the trial predicts it, and [`MODEL_ERROR`] besides.
//!
//! **What cannot be told.** All gages together answering more or less to a newton: it goes into s. A change that acts like a turn of
//! the sensor: it goes into R. What is renewed are the ratios between the gages' answers.
//!
//! **Handedness.** R may be a mirror image, as the trial's own frame may be. The best R of the other hand leaves the squared misfit
//! Σ w‖s₀‖² − (tr Σ − 2σ_r)²/Σ w‖ŝ‖²; unless that is worse by far, there is no answer. It is not where the gages' answers
//! hardly span r directions.

use libm::{hypot, sqrt};

/// The largest proper rank of a trial.
pub const MAX_RANK: usize = 3;

/// r rows of p; those beyond the rank are zero.
pub type Rows<const GAGES: usize> = [[f64; GAGES]; MAX_RANK];

type Square = [[f64; MAX_RANK]; MAX_RANK];

/// How much of a gage's answer no linear shape explains, relative: three times what a real sensor shows at rest (design § 5).
pub const MODEL_ERROR: f64 = 3e-4;

/// Standard deviations from which on a gage pulls no stronger.
const PULL: f64 = 2.0;

/// A gage that answers less than this share of what the gages answer in the mean is held against that share.
const LEAST_ANSWER: f64 = 0.1;

/// How many times worse the other hand must fit, and by how many standard deviations.
const HAND_MARGIN: f64 = 3.0;
const HAND_DEVIATIONS: f64 = 5.0;

/// Repetitions for the weights. Each leaves of the error that comes of the gages that are off no more than their share in all.
const ROUNDS: usize = 12;

/// Determinant of a Gram matrix of rows of length one, below which they are not independent.
const LEAST_DETERMINANT: f64 = 1e-9;

/// Columns are orthogonal when the cosine between them is rounding. Convergence is quadratic: three columns take some five sweeps.
const LARGEST_COSINE: f64 = 4.0 * f64::EPSILON;
const MOST_SWEEPS: usize = 30;

/// What a trial tells of the shape.
#[derive(Clone, Copy, Debug)]
pub struct Unoriented<'a, const GAGES: usize> {
    /// The proper rank r, which is the sensor's number of components.
    pub rank: usize,
    /// Ŝ, counts per unit load.
    pub shape: &'a Rows<GAGES>,
    /// Standard deviation of each of its columns as a vector, counts per unit load.
    pub deviation: &'a [f64; GAGES],
}

/// The same in the frame of the calibration that there is.
#[derive(Clone, Debug)]
pub struct Oriented<const GAGES: usize> {
    /// s R Ŝ, counts per newton.
    pub shape: Rows<GAGES>,
    /// 1/s: the magnitude of the trial's load by the calibration that there is, newton.
    pub load_newton: f64,
    /// By how much the answer of each gage has changed, relative to it.
    pub drift: [f64; GAGES],
    /// The same in standard deviations.
    pub drift_deviations: [f64; GAGES],
}

/// Why there is no orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoOrientation {
    /// A number is not finite, or the rows of a shape are not independent.
    Degenerate,
    /// A mirror image fits nearly as well.
    EitherHand,
}

/// Orients a trial by the shape S₀ that is known, counts per newton.
///
/// # Errors
///
/// [`NoOrientation`].
#[inline(never)]
pub fn orient<const GAGES: usize>(
    trial: &Unoriented<'_, GAGES>,
    known: &Rows<GAGES>,
) -> Result<Oriented<GAGES>, NoOrientation> {
    let answers: [f64; GAGES] = core::array::from_fn(|gage| column_length(known, gage));
    let (size, own_size) = (root_of_squares(&answers), total_length(trial.shape));
    let least_answer = LEAST_ANSWER * size / sqrt(GAGES as f64);
    let answers = answers.map(|answer| answer.max(least_answer));
    let tolerances: [f64; GAGES] = core::array::from_fn(|gage| {
        hypot(trial.deviation[gage] * size / own_size, MODEL_ERROR * answers[gage])
    });
    let mut off = [0.0; GAGES];
    let mut fit = Fit { scale: 0.0, turn: [[0.0; MAX_RANK]; MAX_RANK], misfit: 0.0, other_hand: 0.0 };
    let mut shape = *known;
    for _ in 0..ROUNDS {
        let weights = core::array::from_fn(|gage| {
            let pull = (PULL * tolerances[gage] / off[gage]).min(1.0);
            pull / (tolerances[gage] * tolerances[gage])
        });
        fit = Fit::new(trial.rank, trial.shape, known, &weights).ok_or(NoOrientation::Degenerate)?;
        shape = fit.turned(trial.shape);
        off = core::array::from_fn(|gage| {
            let difference = |row: usize| shape[row][gage] - known[row][gage];
            sqrt((0..MAX_RANK).map(|row| difference(row) * difference(row)).sum())
        });
    }
    // Of squares of standard deviations.
    let margin = (HAND_MARGIN * HAND_MARGIN * fit.misfit).max(HAND_DEVIATIONS * HAND_DEVIATIONS);
    if fit.other_hand < margin {
        return Err(NoOrientation::EitherHand);
    }
    Ok(Oriented {
        shape,
        load_newton: 1.0 / fit.scale,
        drift: core::array::from_fn(|gage| off[gage] / answers[gage]),
        drift_deviations: core::array::from_fn(|gage| off[gage] / tolerances[gage]),
    })
}

/// (AAᵀ)⁻¹A of r independent rows: the shape of a calibration matrix, and the calibration matrix of a shape (eq. 5). `None` where
/// they are not independent, or a number is not finite.
#[inline(never)]
pub fn dual<const GAGES: usize>(rank: usize, rows: &Rows<GAGES>) -> Option<Rows<GAGES>> {
    let mut gram = Square::default();
    for a in 0..MAX_RANK {
        for b in 0..MAX_RANK {
            gram[a][b] = (0..GAGES).map(|gage| rows[a][gage] * rows[b][gage]).sum();
        }
    }
    // What is beyond the rank is the identity.
    for a in rank..MAX_RANK {
        gram[a][a] = 1.0;
    }
    // Cyclic, the signs of the cofactors are all plus.
    let cofactor = |a: usize, b: usize| {
        let (c, d) = ((a + 1) % MAX_RANK, (a + 2) % MAX_RANK);
        let (e, f) = ((b + 1) % MAX_RANK, (b + 2) % MAX_RANK);
        gram[c][e] * gram[d][f] - gram[c][f] * gram[d][e]
    };
    let determinant: f64 = (0..MAX_RANK).map(|b| gram[0][b] * cofactor(0, b)).sum();
    let largest = gram[0][0] * gram[1][1] * gram[2][2];
    let is_independent = determinant.is_finite() && determinant > LEAST_DETERMINANT * largest;
    if !is_independent {
        return None;
    }
    let mut dual = [[0.0; GAGES]; MAX_RANK];
    for a in 0..rank {
        for b in 0..rank {
            let factor = cofactor(a, b) / determinant;
            for gage in 0..GAGES {
                dual[a][gage] += factor * rows[b][gage];
            }
        }
    }
    dual.iter().flatten().all(|element| element.is_finite()).then_some(dual)
}

/// The turn and the scale that bring one shape closest to another.
struct Fit {
    scale: f64,
    turn: Square,
    /// Σ w ‖s R ŝ − s₀‖².
    misfit: f64,
    /// The same with the best R of the other hand.
    other_hand: f64,
}

impl Fit {
    fn new<const GAGES: usize>(
        rank: usize,
        shape: &Rows<GAGES>,
        known: &Rows<GAGES>,
        weights: &[f64; GAGES],
    ) -> Option<Self> {
        // Column b of Σ w s₀ŝᵀ.
        let mut columns = Square::default();
        let (mut own_square, mut known_square) = (0.0, 0.0);
        for gage in 0..GAGES {
            for b in 0..rank {
                let weighted = weights[gage] * shape[b][gage];
                own_square += weighted * shape[b][gage];
                known_square += weights[gage] * known[b][gage] * known[b][gage];
                for a in 0..rank {
                    columns[b][a] += weighted * known[a][gage];
                }
            }
        }
        let mut turns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        orthogonalise(rank, &mut columns, &mut turns);
        let mut turn = Square::default();
        let (mut trace, mut least) = (0.0, f64::INFINITY);
        for (column, along) in columns.iter().zip(&turns).take(rank) {
            let value = sqrt(dot(column, column));
            let has_direction = value.is_finite() && value > 0.0;
            if !has_direction {
                return None;
            }
            trace += value;
            least = value.min(least);
            for a in 0..rank {
                for b in 0..rank {
                    turn[a][b] += column[a] / value * along[b];
                }
            }
        }
        let misfit = |trace: f64| (known_square - trace * trace / own_square).max(0.0);
        let fit = Self {
            scale: trace / own_square,
            turn,
            misfit: misfit(trace),
            other_hand: misfit(trace - 2.0 * least),
        };
        let is_finite = fit.scale.is_finite() && fit.scale > 0.0 && fit.other_hand.is_finite();
        is_finite.then_some(fit)
    }

    /// s R Ŝ.
    fn turned<const GAGES: usize>(&self, shape: &Rows<GAGES>) -> Rows<GAGES> {
        self.turn.map(|row| {
            let mut turned = [0.0; GAGES];
            for (factor, own) in row.iter().zip(shape) {
                for gage in 0..GAGES {
                    turned[gage] += self.scale * factor * own[gage];
                }
            }
            turned
        })
    }
}

/// Turns the first columns of a matrix in pairs until they are orthogonal, and notes the turns.
fn orthogonalise(rank: usize, columns: &mut Square, turns: &mut Square) {
    for _ in 0..MOST_SWEEPS {
        let mut orthogonal = true;
        for p in 0..rank {
            for q in p + 1..rank {
                let (square_p, square_q) = (dot(&columns[p], &columns[p]), dot(&columns[q], &columns[q]));
                let product = dot(&columns[p], &columns[q]);
                if product.abs() <= LARGEST_COSINE * sqrt(square_p) * sqrt(square_q) {
                    continue;
                }
                orthogonal = false;
                // The smaller of the two turns that make the columns orthogonal.
                let half_difference = (square_q - square_p) / (2.0 * product);
                let tangent =
                    half_difference.signum() / (half_difference.abs() + hypot(half_difference, 1.0));
                let cosine = 1.0 / hypot(tangent, 1.0);
                for matrix in [&mut *columns, &mut *turns] {
                    for row in 0..MAX_RANK {
                        let (x, y) = (matrix[p][row], matrix[q][row]);
                        matrix[p][row] = cosine * (x - tangent * y);
                        matrix[q][row] = cosine * (tangent * x + y);
                    }
                }
            }
        }
        if orthogonal {
            return;
        }
    }
}

fn dot(one: &[f64; MAX_RANK], other: &[f64; MAX_RANK]) -> f64 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

fn column_length<const GAGES: usize>(rows: &Rows<GAGES>, gage: usize) -> f64 {
    sqrt(rows.iter().map(|row| row[gage] * row[gage]).sum())
}

fn total_length<const GAGES: usize>(rows: &Rows<GAGES>) -> f64 {
    sqrt(rows.iter().flatten().map(|element| element * element).sum())
}

fn root_of_squares<const GAGES: usize>(values: &[f64; GAGES]) -> f64 {
    sqrt(values.iter().map(|value| value * value).sum())
}
