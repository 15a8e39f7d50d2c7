//! The distribution of the load's directions, as far as moments up to degree four tell it.
//!
//! The covariance of the metric constraint needs moments of degree six of the direction m, which nobody sums up. But the
//! density of m on the unit sphere is known up to degree four: its part of degree l at a direction q is
//! (2l + 1)·⟨Pₗ(q·m)⟩ in space and 2·⟨Tₗ(q·m)⟩ in the plane (addition theorem; Legendre and Chebyshev polynomials). The
//! parts beyond degree four are taken as zero; moments of degree six are then sums over a quadrature that is exact for
//! degree ten.

use nalgebra::SVector;

use super::motion_moments::MotionMoments;

/// Nodes and weights of the Gauss-Legendre rule of six points on [−1, 1], positive half.
const LEGENDRE: [(f64, f64); 3] = [
    (0.238_619_186_083_196_9, 0.467_913_934_572_691),
    (0.661_209_386_466_264_5, 0.360_761_573_048_138_6),
    (0.932_469_514_203_152, 0.171_324_492_379_170_35),
];

/// Steps around the circle: exact for degree ten.
const AROUND: usize = 12;

/// Cosine and sine of half a step, 15°.
const HALF_STEP: (f64, f64) = (0.965_925_826_289_068_3, 0.258_819_045_102_520_76);

/// Cosine and sine of a step, 30°.
const STEP: (f64, f64) = (0.866_025_403_784_438_6, 0.5);

/// Moments of the load's direction m about zero, less the noise; |m| = 1 on average.
#[derive(Clone, Debug)]
pub struct DirectionMoments<const RANK: usize> {
    /// ⟨m⟩.
    pub first: SVector<f64, RANK>,
    /// Degrees two to four.
    pub higher: MotionMoments<RANK>,
}

impl<const RANK: usize> DirectionMoments<RANK> {
    /// From central moments and the mean.
    pub fn new(mean: SVector<f64, RANK>, central: &MotionMoments<RANK>) -> Self {
        Self { higher: central.about_zero(&mean), first: mean }
    }

    /// The density of m on the unit sphere or circle.
    pub fn density(&self) -> Density<RANK> {
        let single = |element: f64| {
            #[expect(clippy::cast_possible_truncation, reason = "a density needs five digits")]
            let element = element as f32;
            element
        };
        let MotionMoments { second, third, fourth } = &self.higher;
        Density {
            first: core::array::from_fn(|a| single(self.first[a])),
            second: second.map(|row| row.map(single)),
            third: third.map(|rows| rows.map(|row| row.map(single))),
            fourth: fourth.map(|blocks| blocks.map(|rows| rows.map(|row| row.map(single)))),
        }
    }

    /// The mean square of the density over the sphere or circle: 1 for directions all over, 1/A for directions all over a
    /// share A of it, as far as degree four tells.
    ///
    /// With the density's parts as above, it is the same sum over ⟨(m·m′)ᵏ⟩ for two independent directions m and m′, which
    /// is the squared norm of the moment tensor of degree k.
    pub fn concentration(&self) -> f64 {
        let mut norms = [self.first.norm_squared(), 0.0, 0.0, 0.0];
        for a in 0..RANK {
            for b in 0..RANK {
                norms[1] += self.higher.second[a][b] * self.higher.second[a][b];
                for c in 0..RANK {
                    norms[2] += self.higher.third[a][b][c] * self.higher.third[a][b][c];
                    for d in 0..RANK {
                        norms[3] += self.higher.fourth[a][b][c][d] * self.higher.fourth[a][b][c][d];
                    }
                }
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "a share needs five digits")]
        let norms = norms.map(|norm| norm as f32);
        f64::from(zonal_sum::<RANK>(norms))
    }
}

/// The density of the load's directions, relative to the uniform one. In single precision, which the sensor has in hardware: it is
/// asked for many directions.
#[derive(Clone, Debug)]
pub struct Density<const RANK: usize> {
    first: [f32; RANK],
    second: [[f32; RANK]; RANK],
    third: [[[f32; RANK]; RANK]; RANK],
    fourth: [[[[f32; RANK]; RANK]; RANK]; RANK],
}

impl<const RANK: usize> Density<RANK> {
    /// The density at a direction; no less than zero.
    pub fn at(&self, direction: &SVector<f32, RANK>) -> f32 {
        zonal_sum::<RANK>(self.powers(direction)).max(0.0)
    }

    /// ⟨(q·m)ᵏ⟩ for k = 1 … 4. The tensors are symmetric, so that each element stands for all orders of its indices.
    fn powers(&self, q: &SVector<f32, RANK>) -> [f32; 4] {
        let mut powers = [0.0; 4];
        for a in 0..RANK {
            powers[0] += q[a] * self.first[a];
            for b in a..RANK {
                let ab = q[a] * q[b];
                powers[1] += orders(&[a, b]) * ab * self.second[a][b];
                for c in b..RANK {
                    let abc = ab * q[c];
                    powers[2] += orders(&[a, b, c]) * abc * self.third[a][b][c];
                    for d in c..RANK {
                        powers[3] += orders(&[a, b, c, d]) * abc * q[d] * self.fourth[a][b][c][d];
                    }
                }
            }
        }
        powers
    }
}

/// In how many orders these ascending indices can be put.
fn orders(ascending: &[usize]) -> f32 {
    let (mut orders, mut run, mut last) = (1.0, 0.0, usize::MAX);
    for (position, &index) in ascending.iter().enumerate() {
        run = if index == last { run + 1.0 } else { 1.0 };
        orders *= (position as f32 + 1.0) / run;
        last = index;
    }
    orders
}

/// Σ (2l + 1) Pₗ(t) in space, 1 + 2 Σ Tₗ(t) in the plane, l up to four, of the mean powers ⟨t⟩ … ⟨t⁴⟩.
fn zonal_sum<const RANK: usize>([t1, t2, t3, t4]: [f32; 4]) -> f32 {
    if RANK == 2 {
        1.0 + 2.0 * (t1 + (2.0 * t2 - 1.0) + (4.0 * t3 - 3.0 * t1) + (8.0 * t4 - 8.0 * t2 + 1.0))
    } else {
        1.0 + 3.0 * t1
            + 5.0 * (3.0 * t2 - 1.0) / 2.0
            + 7.0 * (5.0 * t3 - 3.0 * t1) / 2.0
            + 9.0 * (35.0 * t4 - 30.0 * t2 + 3.0) / 8.0
    }
}

/// Visits directions all over the unit sphere or circle with weights that sum to one.
pub fn for_each_direction<const RANK: usize>(mut visit: impl FnMut(SVector<f64, RANK>, f64)) {
    let mut next = HALF_STEP;
    for _ in 0..AROUND {
        let (cosine, sine) = next;
        // By the addition theorems; each step adds a rounding or two.
        next = (cosine * STEP.0 - sine * STEP.1, sine * STEP.0 + cosine * STEP.1);
        if RANK == 2 {
            visit(direction([cosine, sine, 0.0]), 1.0 / AROUND as f64);
            continue;
        }
        for (height, weight) in LEGENDRE {
            let radius = libm::sqrt(1.0 - height * height);
            for height in [height, -height] {
                visit(direction([radius * cosine, radius * sine, height]), weight / 2.0 / AROUND as f64);
            }
        }
    }
}

fn direction<const RANK: usize>(components: [f64; 3]) -> SVector<f64, RANK> {
    SVector::from_fn(|axis, _| components[axis])
}

#[cfg(test)]
mod tests {
    use super::{for_each_direction, orders};
    use nalgebra::{Vector2, Vector3};

    #[test]
    fn the_orders_are_counted() {
        for (ascending, count) in [
            ([0, 0, 0, 0], 1.0),
            ([0, 1, 1, 1], 4.0),
            ([0, 0, 2, 2], 6.0),
            ([0, 1, 1, 2], 12.0),
            ([0, 1, 2, 3], 24.0),
        ] {
            assert_eq!(orders(&ascending), count);
        }
    }

    /// ⟨x²⟩ = 1/3, ⟨x⁴⟩ = 1/5, ⟨x²y²⟩ = 1/15, ⟨x⁶⟩ = 1/7, ⟨x¹⁰⟩ = 1/11 on the sphere; 1/2, 3/8 and 63/256 on the circle.
    #[test]
    fn the_quadrature_is_exact() {
        let mut sums = [0.0; 6];
        for_each_direction(|q: Vector3<f64>, weight| {
            let terms = [1.0, q.x.powi(2), q.z.powi(4), q.x.powi(2) * q.y.powi(2), q.y.powi(6), q.x.powi(10)];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        });
        for (sum, exact) in sums.into_iter().zip([1.0, 1.0 / 3.0, 0.2, 1.0 / 15.0, 1.0 / 7.0, 1.0 / 11.0]) {
            assert!((sum - exact).abs() < 1e-14, "{sum} {exact}");
        }
        let mut sums = [0.0; 3];
        for_each_direction(|q: Vector2<f64>, weight| {
            let terms = [q.x.powi(2), q.y.powi(4), q.x.powi(10)];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
        });
        for (sum, exact) in sums.into_iter().zip([0.5, 0.375, 63.0 / 256.0]) {
            assert!((sum - exact).abs() < 1e-14, "{sum} {exact}");
        }
    }
}
