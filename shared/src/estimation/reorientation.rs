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
//! **Handedness.** R may be a mirror image, as the trial's own frame may be. The best R of the other hand leaves a squared misfit that is
//! larger by 4σ_r(tr Σ − σ_r)/Σ w‖ŝ‖²; unless that is worse by far, there is no answer. It is not where the gages' answers
//! hardly span r directions.
//!
//! All in single precision, of shapes brought to length one: what is asked for are parts in ten thousand.

use libm::sqrtf;

/// The largest proper rank of a trial.
pub const MAX_RANK: usize = 3;

/// r rows of p; those beyond the rank are zero.
pub type Rows<const GAGES: usize> = [[f32; GAGES]; MAX_RANK];

type Square = [[f32; MAX_RANK]; MAX_RANK];

/// How much of a gage's answer no linear shape explains, relative: three times what a real sensor shows at rest (design § 5).
pub const MODEL_ERROR: f32 = 3e-4;

/// Standard deviations from which on a gage pulls no stronger.
const PULL: f32 = 2.0;

/// A gage that answers less than this share of what the gages answer in the mean is held against that share.
const LEAST_ANSWER: f32 = 0.1;

/// How many times worse the other hand must fit, and by how many standard deviations.
const HAND_MARGIN: f32 = 3.0;
const HAND_DEVIATIONS: f32 = 5.0;

/// Repetitions for the weights. Each leaves of the error that comes of the gages that are off no more than their share in all.
const ROUNDS: usize = 12;

/// The least part of a row that is independent of those before it.
const LEAST_REST: f32 = 1e-3;

/// Columns are orthogonal when the cosine between them is rounding. Convergence is quadratic: three columns take some four sweeps.
const LARGEST_COSINE: f32 = 4.0 * f32::EPSILON;
const MOST_SWEEPS: usize = 30;

/// What a trial tells of the shape.
#[derive(Clone, Copy, Debug)]
pub struct Unoriented<'a, const GAGES: usize> {
    /// The proper rank r, which is the sensor's number of components.
    pub rank: usize,
    /// Ŝ, counts per unit load.
    pub shape: &'a Rows<GAGES>,
    /// Standard deviation of each of its columns as a vector, counts per unit load.
    pub deviation: &'a [f32; GAGES],
}

/// The same in the frame of the calibration that there is.
#[derive(Clone, Debug)]
pub struct Oriented<const GAGES: usize> {
    /// s R Ŝ, counts per newton.
    pub shape: Rows<GAGES>,
    /// 1/s: the magnitude of the trial's load by the calibration that there is, newton.
    pub load_newton: f32,
    /// The largest change of the answer of a gage, relative to it.
    pub drift: f32,
    /// The gage that has changed so.
    pub gage: u8,
    /// The change of each gage's answer, in standard deviations.
    pub drift_deviations: [f32; GAGES],
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
    let (size, own_size) = (length(known.as_flattened()), length(trial.shape.as_flattened()));
    let (mut known, mut own) = (*known, *trial.shape);
    scale(&mut known, 1.0 / size);
    scale(&mut own, 1.0 / own_size);
    let mut answers = [0.0; GAGES];
    let mut tolerances = [0.0; GAGES];
    for gage in 0..GAGES {
        let answer = length(&known.map(|row| row[gage]));
        answers[gage] = answer.max(LEAST_ANSWER / sqrtf(GAGES as f32));
        tolerances[gage] = length(&[trial.deviation[gage] / own_size, MODEL_ERROR * answers[gage]]);
    }

    let mut off = [0.0; GAGES];
    let mut turned = known;
    let mut fit = Fit::default();
    for _ in 0..ROUNDS {
        let mut weights = [0.0; GAGES];
        for gage in 0..GAGES {
            let pull = (PULL * tolerances[gage] / off[gage]).min(1.0);
            weights[gage] = pull / (tolerances[gage] * tolerances[gage]);
        }
        fit = Fit::new(trial.rank, &own, &known, &weights).ok_or(NoOrientation::Degenerate)?;
        turned = fit.turned(&own);
        fit.misfit = 0.0;
        for gage in 0..GAGES {
            off[gage] =
                length(&core::array::from_fn::<_, MAX_RANK, _>(|row| turned[row][gage] - known[row][gage]));
            fit.misfit += weights[gage] * off[gage] * off[gage];
        }
    }
    // Of squares of standard deviations.
    let margin = (HAND_MARGIN * HAND_MARGIN * fit.misfit).max(HAND_DEVIATIONS * HAND_DEVIATIONS);
    let is_told_apart = fit.misfit + fit.other_hand >= margin;
    if !is_told_apart {
        return Err(NoOrientation::EitherHand);
    }
    scale(&mut turned, size);
    let load_newton = own_size / (size * fit.scale);
    let drift_deviations = core::array::from_fn(|gage| off[gage] / tolerances[gage]);
    let mut oriented = Oriented { shape: turned, load_newton, drift: 0.0, gage: 0, drift_deviations };
    for (number, gage) in (0..).zip(0..GAGES) {
        let drift = off[gage] / answers[gage];
        if drift > oriented.drift {
            (oriented.drift, oriented.gage) = (drift, number);
        }
    }
    Ok(oriented)
}

/// (AAᵀ)⁻¹A of r independent rows: the shape of a calibration matrix, and the calibration matrix of a shape (eq. 5). `None` where
/// they are not independent, or a number is not finite.
///
/// With A = LQ, rows of Q orthonormal, it is L⁻ᵀQ: the condition of A is not squared.
#[inline(never)]
pub fn dual<const GAGES: usize>(rank: usize, rows: &Rows<GAGES>) -> Option<Rows<GAGES>> {
    let mut dual = *rows;
    let mut factor = Square::default();
    for a in 0..rank {
        let before = length(&dual[a]);
        for b in 0..a {
            factor[a][b] = dot(&dual[a], &dual[b]);
            subtract(&mut dual, a, b, factor[a][b]);
        }
        let rest = length(&dual[a]);
        let is_independent = rest.is_finite() && rest > LEAST_REST * before;
        if !is_independent {
            return None;
        }
        factor[a][a] = rest;
        dual[a] = dual[a].map(|element| element / rest);
    }
    for a in (0..rank).rev() {
        for b in a + 1..rank {
            subtract(&mut dual, a, b, factor[b][a]);
        }
        dual[a] = dual[a].map(|element| element / factor[a][a]);
    }
    dual.as_flattened().iter().all(|element| element.is_finite()).then_some(dual)
}

/// The turn and the scale that bring one shape closest to another.
#[derive(Default)]
struct Fit {
    scale: f32,
    turn: Square,
    /// Σ w ‖s R ŝ − s₀‖².
    misfit: f32,
    /// By how much more that is with the best R of the other hand.
    other_hand: f32,
}

impl Fit {
    fn new<const GAGES: usize>(
        rank: usize,
        shape: &Rows<GAGES>,
        known: &Rows<GAGES>,
        weights: &[f32; GAGES],
    ) -> Option<Self> {
        // Column b of Σ w s₀ŝᵀ.
        let mut columns = Square::default();
        let mut own_square = 0.0;
        for gage in 0..GAGES {
            for b in 0..rank {
                let weighted = weights[gage] * shape[b][gage];
                own_square += weighted * shape[b][gage];
                for a in 0..rank {
                    columns[b][a] += weighted * known[a][gage];
                }
            }
        }
        let mut turns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        orthogonalise(rank, &mut columns, &mut turns);
        let mut turn = Square::default();
        let (mut trace, mut least) = (0.0, f32::INFINITY);
        for (column, along) in columns.iter().zip(&turns).take(rank) {
            let value = length(column);
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
        let other_hand = 4.0 * least * (trace - least) / own_square;
        let fit = Self { scale: trace / own_square, turn, misfit: 0.0, other_hand };
        (fit.scale > 0.0 && other_hand.is_finite()).then_some(fit)
    }

    /// s R Ŝ.
    fn turned<const GAGES: usize>(&self, shape: &Rows<GAGES>) -> Rows<GAGES> {
        let mut turned = [[0.0; GAGES]; MAX_RANK];
        for a in 0..MAX_RANK {
            for b in 0..MAX_RANK {
                let factor = self.scale * self.turn[a][b];
                for gage in 0..GAGES {
                    turned[a][gage] += factor * shape[b][gage];
                }
            }
        }
        turned
    }
}

/// Turns the first columns of a matrix in pairs until they are orthogonal, and notes the turns.
fn orthogonalise(rank: usize, columns: &mut Square, turns: &mut Square) {
    for _ in 0..MOST_SWEEPS {
        let mut orthogonal = true;
        for p in 0..rank {
            for q in p + 1..rank {
                let (length_p, length_q) = (length(&columns[p]), length(&columns[q]));
                let product = dot(&columns[p], &columns[q]);
                if product.abs() <= LARGEST_COSINE * length_p * length_q {
                    continue;
                }
                orthogonal = false;
                // The smaller of the two turns that make the columns orthogonal.
                let half_difference = (length_q - length_p) * (length_q + length_p) / (2.0 * product);
                let tangent =
                    half_difference.signum() / (half_difference.abs() + length(&[half_difference, 1.0]));
                let cosine = 1.0 / length(&[tangent, 1.0]);
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

/// Takes a multiple of one row from another.
fn subtract<const GAGES: usize>(rows: &mut Rows<GAGES>, from: usize, row: usize, factor: f32) {
    for gage in 0..GAGES {
        rows[from][gage] -= factor * rows[row][gage];
    }
}

fn scale<const GAGES: usize>(rows: &mut Rows<GAGES>, factor: f32) {
    rows.as_flattened_mut().iter_mut().for_each(|element| *element *= factor);
}

#[inline(never)]
fn dot(one: &[f32], other: &[f32]) -> f32 {
    one.iter().zip(other).map(|(one, other)| one * other).sum()
}

fn length(vector: &[f32]) -> f32 {
    sqrtf(dot(vector, vector))
}
