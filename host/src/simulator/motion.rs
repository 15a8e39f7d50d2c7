//! Hand-like motion: a sensor turned at random in gravity, with rests, and what the load on it feels meanwhile.
//!
//! **Turning.** A hand turns the sensor from one orientation to the next about one axis, with the minimum-jerk profile
//! of human reaching (Flash and Hogan, 1985): s(τ) = 10τ³ − 15τ⁴ + 6τ⁵, at rest at both ends, at a mean of half a radian
//! per second and at most one radian per second squared. Meanwhile it moves by some centimetres with the same profile.
//! Most turns end in a short rest. In space the next direction of gravity in the sensor frame is, of a few random ones,
//! the one farthest from those visited lately, as somebody does who has been told to reach all sides; a random twist
//! about gravity comes with it. In the plane the force always turns in one sense.
//!
//! **What the load feels.** Let d be the direction of gravity, ω and α the sensor's angular velocity and acceleration
//! and c the acceleration of its origin, all in the sensor frame. A point mass held rigidly at the arm a accelerates
//! with c + α × a + ω × (ω × a), so it presses on the sensor with the
//!
//! > specific force f/m = g·d − c − α × a − ω × (ω × a)
//!
//! whose magnitude wobbles about g while the sensor turns (by about 1 % at arms of 10 cm) and is g at rest.
//! The load's own rotary inertia (an ideal point has none) and the hand's tremor are left out.
//!
//! Fixed vectors of the world turn the other way in the sensor frame: ḋ = −ω × d.

use std::collections::VecDeque;

use nalgebra::{Rotation3, UnitQuaternion, UnitVector3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, UnitSphere};

use super::{Purpose, random_sequence};

/// Mean angular speed of a turn, radian per second; the peak of the profile is 15/8 of it.
const MEAN_SPEED: f64 = 0.5;
/// The largest angular acceleration, radian per second squared.
const LARGEST_ACCELERATION: f64 = 1.0;
/// The largest magnitude of d²s/dτ²: 10/√3.
const PEAK_OF_PROFILE: f64 = 5.773_502_691_896_258;
/// The farthest that the hand moves during a turn, metre.
const LARGEST_DISPLACEMENT: f64 = 0.1;
/// The largest acceleration of the hand's displacement, metre per second squared.
const LARGEST_HAND_ACCELERATION: f64 = 0.1;
/// The largest twist about gravity in one turn, radian.
const LARGEST_TWIST: f64 = 0.5;
/// How many directions are considered for the next turn, and how many visited ones are remembered.
const CANDIDATES: usize = 8;
const REMEMBERED: usize = 16;
/// Share of turns that end in a rest, and how long a rest lasts, second.
const REST_PROBABILITY: f64 = 0.75;
const REST_SECONDS: std::ops::Range<f64> = 0.4..1.6;
/// How far one turn goes in the plane, radian.
const PLANE_TURN: std::ops::Range<f64> = 0.6..2.2;

/// The sense in which the force turns in the sensor frame, seen from +z.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turning {
    /// From x towards y.
    Counterclockwise,
    /// From y towards x.
    Clockwise,
}

/// One moment of the motion, every vector in the sensor frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotionState {
    /// The direction in which gravity pulls.
    pub gravity_direction: UnitVector3<f64>,
    /// Angular velocity of the sensor, radian per second.
    pub angular_velocity: Vector3<f64>,
    /// Angular acceleration of the sensor, radian per second squared.
    pub angular_acceleration: Vector3<f64>,
    /// Acceleration of the sensor's origin, metre per second squared.
    pub origin_acceleration: Vector3<f64>,
}

impl MotionState {
    /// Rest with gravity along this direction.
    const fn at_rest(gravity_direction: UnitVector3<f64>) -> Self {
        Self {
            gravity_direction,
            angular_velocity: Vector3::new(0.0, 0.0, 0.0),
            angular_acceleration: Vector3::new(0.0, 0.0, 0.0),
            origin_acceleration: Vector3::new(0.0, 0.0, 0.0),
        }
    }

    /// Force for each kilogram of a point mass at this arm, newton per kilogram.
    pub fn specific_force(&self, gravity: f64, arm_m: &Vector3<f64>) -> Vector3<f64> {
        let centripetal = self.angular_velocity.cross(&self.angular_velocity.cross(arm_m));
        let tangential = self.angular_acceleration.cross(arm_m);
        self.gravity_direction.into_inner() * gravity - self.origin_acceleration - tangential - centripetal
    }
}

/// What the hand is asked to do.
#[derive(Clone, Copy, Debug)]
enum Task {
    Hold,
    TurnInSpace,
    TurnInPlane(Turning),
}

/// One stretch of the motion: a turn by `angle` about `axis` while the hand moves by `displacement`, or a rest, which
/// is a turn by nothing.
#[derive(Clone, Debug)]
struct Stretch {
    from: UnitVector3<f64>,
    axis: UnitVector3<f64>,
    angle: f64,
    displacement: Vector3<f64>,
    seconds: f64,
}

impl Stretch {
    fn rest(at: UnitVector3<f64>, seconds: f64) -> Self {
        Self { from: at, axis: Vector3::z_axis(), angle: 0.0, displacement: Vector3::zeros(), seconds }
    }

    fn turn(from: UnitVector3<f64>, axis: UnitVector3<f64>, angle: f64, displacement: Vector3<f64>) -> Self {
        let seconds = (angle / MEAN_SPEED)
            .max((PEAK_OF_PROFILE * angle / LARGEST_ACCELERATION).sqrt())
            .max((PEAK_OF_PROFILE * displacement.norm() / LARGEST_HAND_ACCELERATION).sqrt());
        Self { from, axis, angle, displacement, seconds }
    }

    fn at(&self, seconds: f64) -> MotionState {
        if self.angle == 0.0 {
            return MotionState::at_rest(self.from);
        }
        let t = (seconds / self.seconds).clamp(0.0, 1.0);
        let position = t * t * t * (10.0 - 15.0 * t + 6.0 * t * t);
        let speed = 30.0 * t * t * (1.0 - t) * (1.0 - t) / self.seconds;
        let acceleration = 60.0 * t * (1.0 - t) * (1.0 - 2.0 * t) / (self.seconds * self.seconds);
        let world_into_sensor = Rotation3::from_axis_angle(&self.axis, -self.angle * position);
        MotionState {
            gravity_direction: UnitVector3::new_normalize(world_into_sensor * self.from.into_inner()),
            angular_velocity: self.axis.into_inner() * (self.angle * speed),
            angular_acceleration: self.axis.into_inner() * (self.angle * acceleration),
            origin_acceleration: world_into_sensor * self.displacement * acceleration,
        }
    }
}

/// A hand that holds or turns a sensor.
#[derive(Clone, Debug)]
pub struct HandMotion {
    random: ChaCha8Rng,
    task: Task,
    stretch: Stretch,
    elapsed_seconds: f64,
    visited: VecDeque<UnitVector3<f64>>,
}

impl HandMotion {
    /// A hand that holds the sensor with gravity along −z of the sensor frame.
    pub fn new(seed: u64) -> Self {
        Self {
            random: random_sequence(seed, Purpose::Motion),
            task: Task::Hold,
            stretch: Stretch::rest(-Vector3::z_axis(), f64::INFINITY),
            elapsed_seconds: 0.0,
            visited: VecDeque::with_capacity(REMEMBERED),
        }
    }

    /// Holds the sensor still from now on, with gravity along this direction; how it gets there takes no time.
    pub fn hold(&mut self, gravity_direction: UnitVector3<f64>) {
        self.task = Task::Hold;
        self.begin(Stretch::rest(gravity_direction, f64::INFINITY));
    }

    /// Turns the sensor through all directions of space from now on, beginning at rest where it is.
    pub fn turn_in_space(&mut self) {
        self.start(Task::TurnInSpace);
    }

    /// Turns the sensor about its z axis from now on, beginning at rest where it is, so that gravity turns in this
    /// sense in the sensor frame.
    pub fn turn_in_plane(&mut self, turning: Turning) {
        self.start(Task::TurnInPlane(turning));
    }

    /// The motion at this moment.
    pub fn state(&self) -> MotionState {
        self.stretch.at(self.elapsed_seconds)
    }

    /// Lets time pass.
    pub fn advance(&mut self, seconds: f64) {
        self.elapsed_seconds += seconds;
        while self.elapsed_seconds >= self.stretch.seconds {
            let surplus = self.elapsed_seconds - self.stretch.seconds;
            let next = self.next_stretch();
            self.begin(next);
            self.elapsed_seconds = surplus;
        }
    }

    fn start(&mut self, task: Task) {
        let here = self.state().gravity_direction;
        self.task = task;
        let turn = self.next_turn(here);
        self.begin(turn);
    }

    fn begin(&mut self, stretch: Stretch) {
        self.stretch = stretch;
        self.elapsed_seconds = 0.0;
    }

    fn next_stretch(&mut self) -> Stretch {
        let here = self.stretch.at(self.stretch.seconds).gravity_direction;
        let has_turned = self.stretch.angle != 0.0;
        if has_turned && self.random.random_bool(REST_PROBABILITY) {
            let seconds = self.random.random_range(REST_SECONDS);
            return Stretch::rest(here, seconds);
        }
        self.next_turn(here)
    }

    fn next_turn(&mut self, here: UnitVector3<f64>) -> Stretch {
        let [x, y, z]: [f64; 3] = UnitSphere.sample(&mut self.random);
        let way = self.random.random_range(0.0..LARGEST_DISPLACEMENT);
        match self.task {
            Task::Hold => Stretch::rest(here, f64::INFINITY),
            Task::TurnInSpace => {
                let there = self.next_direction(here);
                let twist = self.random.random_range(-LARGEST_TWIST..LARGEST_TWIST);
                // Where opposite directions leave the axis open, any across will do.
                let shortest = UnitQuaternion::rotation_between_axis(&here, &there).unwrap_or_else(|| {
                    UnitQuaternion::from_axis_angle(&any_across(&here), std::f64::consts::PI)
                });
                let world_in_sensor = shortest * UnitQuaternion::from_axis_angle(&here, twist);
                let (axis, angle) =
                    world_in_sensor.inverse().axis_angle().unwrap_or((Vector3::z_axis(), f64::EPSILON));
                Stretch::turn(here, axis, angle, Vector3::new(x, y, z) * way)
            }
            Task::TurnInPlane(turning) => {
                let angle = self.random.random_range(PLANE_TURN);
                // Gravity turns one way in the sensor frame because the sensor turns the other way.
                let axis = match turning {
                    Turning::Counterclockwise => -Vector3::z_axis(),
                    Turning::Clockwise => Vector3::z_axis(),
                };
                Stretch::turn(here, axis, angle, Vector3::new(x, y, 0.0) * way)
            }
        }
    }

    /// Of a few random directions the one farthest from all that were visited lately.
    fn next_direction(&mut self, here: UnitVector3<f64>) -> UnitVector3<f64> {
        if self.visited.len() == REMEMBERED {
            self.visited.pop_front();
        }
        self.visited.push_back(here);
        let mut best = here;
        let mut best_cosine = f64::INFINITY;
        for _ in 0..CANDIDATES {
            let candidate: [f64; 3] = UnitSphere.sample(&mut self.random);
            let candidate = UnitVector3::new_normalize(Vector3::from(candidate));
            let nearest = self.visited.iter().map(|visited| visited.dot(&candidate)).fold(-1.0, f64::max);
            if nearest < best_cosine {
                (best, best_cosine) = (candidate, nearest);
            }
        }
        best
    }
}

/// A direction at right angles to this one.
fn any_across(direction: &UnitVector3<f64>) -> UnitVector3<f64> {
    let least = direction.iamin();
    UnitVector3::new_normalize(direction.cross(&Vector3::ith_axis(least)))
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, UnitVector3, Vector3};

    use super::{HandMotion, LARGEST_ACCELERATION, MotionState, Turning, any_across};

    const STEP: f64 = 0.001;

    fn states(mut motion: HandMotion, seconds: u32) -> Vec<MotionState> {
        (0..seconds * 1000)
            .map(|_| {
                motion.advance(STEP);
                motion.state()
            })
            .collect()
    }

    fn in_space(seed: u64, seconds: u32) -> Vec<MotionState> {
        let mut motion = HandMotion::new(seed);
        motion.turn_in_space();
        states(motion, seconds)
    }

    fn in_plane(seed: u64, turning: Turning) -> Vec<MotionState> {
        let mut motion = HandMotion::new(seed);
        motion.hold(Vector3::x_axis());
        motion.turn_in_plane(turning);
        states(motion, 60)
    }

    #[test]
    fn a_minute_covers_the_sphere() {
        for seed in 0..20 {
            let mut spread = Matrix3::zeros();
            let mut mean = Vector3::zeros();
            let states = in_space(seed, 60);
            for state in &states {
                let d = state.gravity_direction.into_inner();
                spread += d * d.transpose() / states.len() as f64;
                mean += d / states.len() as f64;
            }
            // Uniform on the sphere: eigenvalues of 1/3 and mean 0; in a plane or a half-sphere: 0, or 1/2.
            let least = spread.symmetric_eigenvalues().min();
            assert!(least > 0.15, "seed {seed}: {least}");
            assert!(mean.norm() < 0.3, "seed {seed}: {}", mean.norm());
        }
    }

    #[test]
    fn every_direction_is_near_one_that_was_visited() {
        for seed in 0..5 {
            let visited = in_space(seed, 60);
            for probe in in_space(seed + 100, 60).iter().step_by(500) {
                let nearest = visited
                    .iter()
                    .map(|state| state.gravity_direction.dot(&probe.gravity_direction))
                    .fold(-1.0, f64::max);
                assert!(nearest > 50.0_f64.to_radians().cos(), "seed {seed}: {nearest}");
            }
        }
    }

    #[test]
    fn rest_and_turning_alternate() {
        for seed in 0..10 {
            let states = in_space(seed, 60);
            let resting = states.iter().filter(|state| state.angular_velocity.norm() == 0.0).count();
            let share = resting as f64 / states.len() as f64;
            assert!((0.05..0.5).contains(&share), "seed {seed}: {share}");
            let rests = states.windows(2).filter(|pair| {
                pair[0].angular_velocity.norm() > 0.0 && pair[1].angular_velocity.norm() == 0.0
            });
            assert!(rests.count() >= 6, "seed {seed}");
        }
    }

    #[test]
    fn velocities_and_accelerations_are_derivatives() {
        for state in in_space(4, 30).windows(2) {
            let [before, after] = state else { unreachable!("windows of two") };
            let change =
                (after.gravity_direction.into_inner() - before.gravity_direction.into_inner()) / STEP;
            let expected = -before.angular_velocity.cross(&before.gravity_direction);
            // The step's remainder: |d²d/dt²|·STEP/2 with |α| ≤ 1 and |ω| ≤ 15/8·0.5, ω² < 0.9.
            assert!((change - expected).norm() < STEP);
            let acceleration = (after.angular_velocity - before.angular_velocity) / STEP;
            // A turn about a new axis begins with a finite jerk: at most 60·v/T² with T² ≥ 5.77·angle.
            assert!((acceleration - before.angular_acceleration).norm() < 0.05);
            assert!(before.angular_acceleration.norm() <= LARGEST_ACCELERATION * (1.0 + 1e-12));
        }
    }

    #[test]
    fn magnitude_wobbles_by_about_a_percent_and_not_at_rest() {
        let (gravity, arm) = (9.80665, Vector3::new(0.08, 0.06, 0.08));
        for seed in 0..10 {
            let mut squares = 0.0;
            let states = in_space(seed, 60);
            for state in &states {
                let wobble = state.specific_force(gravity, &arm).norm() / gravity - 1.0;
                squares += wobble * wobble / states.len() as f64;
                assert!(wobble.abs() < 0.05);
                if state.angular_velocity.norm() == 0.0 {
                    assert!(wobble.abs() < 1e-14);
                }
            }
            assert!((0.002..0.02).contains(&squares.sqrt()), "seed {seed}: {}", squares.sqrt());
        }
    }

    #[test]
    fn in_the_plane_the_force_turns_in_the_sense_asked_for() {
        for seed in 0..5 {
            for (turning, sign) in [(Turning::Counterclockwise, 1.0), (Turning::Clockwise, -1.0)] {
                let mut turned = 0.0;
                for state in in_plane(seed, turning).windows(2) {
                    let [a, b] = state else { unreachable!("windows of two") };
                    assert!(a.gravity_direction.z.abs() < 1e-12);
                    let step = sign * a.gravity_direction.cross(&b.gravity_direction).z;
                    assert!(step >= -1e-12);
                    turned += step;
                }
                assert!(turned > 2.0 * std::f64::consts::TAU, "more than twice around: {turned}");
            }
        }
    }

    #[test]
    fn holding_holds() {
        let mut motion = HandMotion::new(1);
        motion.turn_in_space();
        motion.advance(3.3);
        let direction = UnitVector3::new_normalize(Vector3::new(1.0, -2.0, 0.5));
        motion.hold(direction);
        for _ in 0..100 {
            motion.advance(1.0);
            assert_eq!(motion.state(), MotionState::at_rest(direction));
        }
    }

    #[test]
    fn across_is_across() {
        for direction in [Vector3::x_axis(), Vector3::y_axis(), -Vector3::z_axis()] {
            assert!(any_across(&direction).dot(&direction).abs() < 1e-15);
        }
    }
}
