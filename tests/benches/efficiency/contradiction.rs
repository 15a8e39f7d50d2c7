//! Sessions that say something false, each in one thing alone and so that it shows.
//!
//! What no method can see is left out by construction:
//!
//! * all masses wrong by one factor, all arms by one factor, one shift or one turn: the same numbers come from another sensor;
//! * arms that end in a triangle of the same proportions as the true ones: where these exchange two corners of an isosceles
//!   triangle, say, only directions tell, and not those near the plane that maps it onto itself. So the sides of the stated
//!   triangle, over its circumference, differ from the true ones by [`LEAST_CHANGE`] at least;
//! * a direction turned over at a right angle to all others that are known: the mirror image of its trial fits as well. So it
//!   is oblique to another one of its trial; alone, it is oblique to the plane of the arms;
//! * more than one wrong thing at a time: two of three trials mirrored consistently are right, and the third is wrong;
//! * what is wrong by less than it may be: masses are off by 10 %, a hundred times their accuracy.

use nalgebra::DVector;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::session::unit;

/// What is false.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Fault {
    /// One mass, by 10 to 100 %.
    WrongMass,
    /// Two arms are exchanged.
    SwappedArms,
    /// One arm has the wrong sign.
    FlippedArm,
    /// One arm is elsewhere.
    MisplacedArm,
    /// One known direction has the wrong sign.
    FlippedDirection,
}

/// The least change of a side over the circumference that makes another triangle.
const LEAST_CHANGE: f64 = 0.05;

/// How far from a right angle a flipped direction is to another one, cosine.
const OBLIQUE: f64 = 0.5;

/// A mass wrong by 10 to 100 %, either way.
pub(crate) fn wrong_mass(true_kg: f64, rng: &mut ChaCha8Rng) -> f64 {
    let factor = rng.random_range(1.1..2.0);
    if rng.random() { true_kg * factor } else { true_kg / factor }
}

/// Arms with one fault among three or more; `None` where that leaves their proportions as they are.
pub(crate) fn wrong_arms(
    fault: Fault,
    arms_m: &[DVector<f64>],
    rng: &mut ChaCha8Rng,
) -> Option<Vec<DVector<f64>>> {
    let mut wrong = arms_m.to_vec();
    let first = rng.random_range(0..wrong.len());
    match fault {
        Fault::SwappedArms => wrong.swap(first, (first + 1) % arms_m.len()),
        Fault::FlippedArm => wrong[first].neg_mut(),
        Fault::MisplacedArm => wrong[first] += unit(arms_m[first].len(), rng) * rng.random_range(0.02..0.2),
        Fault::WrongMass | Fault::FlippedDirection => {}
    }
    let (stated, truth) = (proportions(&wrong), proportions(arms_m));
    let change = stated.iter().zip(&truth).map(|(stated, truth)| (stated - truth).abs()).fold(0.0, f64::max);
    (change >= LEAST_CHANGE).then_some(wrong)
}

/// The distances between all arms over their sum.
fn proportions(arms_m: &[DVector<f64>]) -> Vec<f64> {
    let pairs = (0..arms_m.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
    let sides: Vec<f64> = pairs.map(|(a, b)| (&arms_m[a] - &arms_m[b]).norm()).collect();
    let around: f64 = sides.iter().sum();
    sides.iter().map(|side| side / around).collect()
}

/// A direction of these that is oblique to another one of them.
pub(crate) fn oblique(directions: &[DVector<f64>]) -> Option<usize> {
    (0..directions.len()).find(|&one| {
        let mut others = (0..directions.len()).filter(|&other| other != one);
        others.any(|other| directions[one].dot(&directions[other]).abs() >= OBLIQUE)
    })
}
