//! The calibration bench: a sensor with a load in somebody's hand, and the converter that reads it, in virtual time.
//!
//! Time moves only by [`Bench::next_conversion`], by one period of the data rate that the converter is configured for.
//! At the end of each period the motion, the load and the sensor are evaluated at that moment (the converter's filter
//! is left out), the faults have their say, and the converter converts. Everything follows from the scenario's sensor,
//! the seed and the calls made: the same calls give the same codes.
//!
//! A load is a point mass at a moment arm (metre, sensor frame). It presses on the sensor with the force of
//! [`MotionState`] and the torque arm × force. At rest the force's magnitude is mass times [`STANDARD_GRAVITY`].
//! Without a load the sensor reads its bias: the weight of the sensor itself is left out.
//!
//! [`MotionState`]: super::motion::MotionState

use ftcal_shared::units::DeviceTime;
use nalgebra::{UnitVector3, Vector3};
use rand_chacha::ChaCha8Rng;

use super::ads131m08::{Ads131m08Model, CHANNELS};
use super::fault::{ActiveFaults, Fault};
use super::motion::{HandMotion, Turning};
use super::sensor::{SoftwareSensor, Wrench, volts_of_counts};
use super::{Purpose, random_sequence};

/// Gravity on the bench, metre per second squared.
pub const STANDARD_GRAVITY: f64 = 9.80665;

const NANOSECONDS: u64 = 1_000_000_000;

/// What hangs on the sensor, its fixture included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Mass, kilogram.
    pub mass_kg: f64,
    /// Where its centre of mass is, in the sensor frame, metre; zero for a sensor that feels no torque.
    pub arm_m: Vector3<f64>,
}

/// The bench.
#[derive(Clone, Debug)]
pub struct Bench {
    sensor: SoftwareSensor,
    load: Option<Load>,
    motion: HandMotion,
    converter: Ads131m08Model,
    faults: ActiveFaults,
    noise: ChaCha8Rng,
    now_nanoseconds: u64,
}

impl Bench {
    /// A bench with this sensor, unloaded and at rest with gravity along −z, its converter just switched on.
    pub fn new(sensor: SoftwareSensor, seed: u64) -> Self {
        Self {
            sensor,
            load: None,
            motion: HandMotion::new(seed),
            converter: Ads131m08Model::power_on(),
            faults: ActiveFaults::none(seed),
            noise: random_sequence(seed, Purpose::Noise),
            now_nanoseconds: 0,
        }
    }

    /// The sensor with its truth.
    pub const fn sensor(&self) -> &SoftwareSensor {
        &self.sensor
    }

    /// Hangs this load on the sensor, in place of any other.
    pub const fn hang(&mut self, load: Load) {
        self.load = Some(load);
    }

    /// Takes the load off.
    pub const fn unload(&mut self) {
        self.load = None;
    }

    /// Rests from now on with the load's force exactly along this direction of the sensor frame.
    pub fn hold(&mut self, force_direction: UnitVector3<f64>) {
        self.motion.hold(force_direction);
    }

    /// Turns the sensor through all directions of space from now on.
    pub fn turn(&mut self) {
        self.motion.turn_in_space();
    }

    /// Turns the sensor about its z axis from now on, the force in this sense; [`Bench::hold`] it in the plane first.
    pub fn turn_in_plane(&mut self, turning: Turning) {
        self.motion.turn_in_plane(turning);
    }

    /// Lets a fault act from now on.
    pub fn inject(&mut self, fault: Fault) {
        if let Fault::WrongIdentity { id } = fault {
            self.converter.pretend_identity(id);
        }
        self.faults.inject(fault);
    }

    /// Takes back every fault.
    pub fn clear_faults(&mut self) {
        self.converter.admit_identity();
        self.faults.clear();
    }

    /// Virtual time since the bench was set up.
    pub const fn now(&self) -> DeviceTime {
        DeviceTime::from_micros(self.now_nanoseconds / 1000)
    }

    /// Force and torque on the sensor at this moment, in the sensor frame.
    pub fn true_wrench(&self) -> Wrench {
        self.load.map_or_else(Wrench::default, |load| {
            let specific = self.motion.state().specific_force(STANDARD_GRAVITY, &load.arm_m);
            Wrench::of_force_at(specific * load.mass_kg, &load.arm_m)
        })
    }

    /// Moves time by one conversion period and converts; true when data ready announces the result.
    pub fn next_conversion(&mut self) -> bool {
        let period_nanoseconds = NANOSECONDS / u64::from(self.converter.data_rate().hertz());
        let period = period_nanoseconds as f64 / NANOSECONDS as f64;
        self.now_nanoseconds += period_nanoseconds;
        self.motion.advance(period);
        let mut volts = [0.0; CHANNELS];
        let wrench = self.true_wrench();
        let counts = self.sensor.read(&wrench, &mut self.noise);
        for (volts, &counts) in volts.iter_mut().zip(counts.iter()) {
            *volts = volts_of_counts(counts);
        }
        let mut felt = [0.0; CHANNELS];
        let of_load = self.sensor.noiseless_counts(&wrench) - self.sensor.bias_counts();
        for (volts, &counts) in felt.iter_mut().zip(of_load.iter()) {
            *volts = volts_of_counts(counts);
        }
        self.faults.disturb_inputs(&mut volts, &felt, self.now().as_seconds(), period);
        let announced = self.converter.convert(&volts);
        announced && !self.faults.converter_missing() && !self.faults.loses_data_ready()
    }

    /// One chip-select frame on the converter's bus, bus faults included.
    pub fn exchange(&mut self, from_host: &[u8], to_host: &mut [u8]) {
        let mut command = from_host.to_vec();
        self.faults.disturb_command(&mut command);
        if !self.faults.converter_missing() {
            self.converter.exchange(&command, to_host);
        }
        self.faults.disturb_reply(to_host);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use ftcal_shared::units::{AdcCode, DataRate, Dof};
    use nalgebra::{UnitVector3, Vector3};

    use super::{Bench, Load, STANDARD_GRAVITY};
    use crate::simulator::ads131m08::CHANNELS;
    use crate::simulator::motion::Turning;
    use crate::simulator::scenario::{Scenario, ScenarioKind};
    use crate::simulator::sensor::SoftwareSensor;

    /// The registers CLOCK, GAIN1 and GAIN2: every channel, 1000 samples/s, gain 128.
    const CONFIGURATION: [u16; 4] = [0x6182, 0xFF16, 0x7777, 0x7777];

    /// A bench with this scenario's sensor, its converter configured.
    pub(in crate::simulator) fn bench(kind: ScenarioKind, seed: u64) -> Bench {
        let mut bench = Bench::new(Scenario::new(kind, seed).expect("sizes fit").sensor, seed);
        write(&mut bench, &CONFIGURATION);
        bench
    }

    /// Sends these words in one frame.
    pub(in crate::simulator) fn write(bench: &mut Bench, words: &[u16]) {
        let mut frame = [0; 30];
        for (bytes, word) in frame.chunks_exact_mut(3).zip(words) {
            bytes[..2].copy_from_slice(&word.to_be_bytes());
        }
        bench.exchange(&frame, &mut [0; 30]);
    }

    /// Converts once and reads the frame's words.
    pub(in crate::simulator) fn frame(bench: &mut Bench) -> [[u8; 3]; 10] {
        bench.next_conversion();
        let mut frame = [0; 30];
        bench.exchange(&[0; 30], &mut frame);
        std::array::from_fn(|word| std::array::from_fn(|byte| frame[3 * word + byte]))
    }

    /// Converts once and reads the codes.
    pub(in crate::simulator) fn codes(bench: &mut Bench) -> [AdcCode; CHANNELS] {
        let frame = frame(bench);
        std::array::from_fn(|channel| AdcCode::from_be_bytes(frame[1 + channel]))
    }

    fn oblique() -> UnitVector3<f64> {
        UnitVector3::new_normalize(Vector3::new(0.3, -0.8, 0.5))
    }

    #[test]
    fn at_rest_the_force_is_the_weight_along_the_direction() {
        let mut bench = bench(ScenarioKind::Wrist, 1);
        let load = Load { mass_kg: 2.0, arm_m: Vector3::new(0.1, -0.05, 0.08) };
        assert_eq!(bench.true_wrench().force_newton.norm(), 0.0);
        bench.hang(load);
        bench.hold(oblique());
        for _ in 0..100 {
            bench.next_conversion();
            let force = bench.true_wrench().force_newton;
            let weight = oblique().into_inner() * (load.mass_kg * STANDARD_GRAVITY);
            assert!((force - weight).norm() < 1e-13 * weight.norm());
        }
        bench.unload();
        assert_eq!(bench.true_wrench().force_newton.norm(), 0.0);
    }

    #[test]
    fn torque_is_arm_times_force_also_while_turning() {
        let mut bench = bench(ScenarioKind::Wrist, 2);
        let arm = Vector3::new(0.1, -0.05, 0.08);
        bench.hang(Load { mass_kg: 2.0, arm_m: arm });
        bench.turn();
        for _ in 0..5000 {
            bench.next_conversion();
            let wrench = bench.true_wrench();
            assert_eq!(wrench.torque_newton_metre, arm.cross(&wrench.force_newton));
        }
    }

    #[test]
    fn the_planar_squashing_matrix_of_eq_14() {
        let mut bench = bench(ScenarioKind::Planar, 2);
        let arm = Vector3::new(0.06, 0.01, 0.0);
        bench.hang(Load { mass_kg: 0.5, arm_m: arm });
        bench.hold(Vector3::y_axis());
        bench.turn_in_plane(Turning::Clockwise);
        for _ in 0..5000 {
            bench.next_conversion();
            let components = bench.true_wrench().components(Dof::PlanarForceTorque);
            let (fx, fy, torque) = (components[0], components[1], components[2]);
            assert!((torque - (-arm.y * fx + arm.x * fy)).abs() < 1e-12);
        }
    }

    #[test]
    fn codes_are_the_sensor_s_counts_within_its_noise() {
        let mut bench = bench(ScenarioKind::Wrist, 3);
        bench.hang(Load { mass_kg: 2.0, arm_m: Vector3::new(0.1, 0.02, 0.05) });
        bench.hold(oblique());
        let expected = bench.sensor().noiseless_counts(&bench.true_wrench());
        let n = 4000;
        let mut sums = [0.0; CHANNELS];
        for _ in 0..n {
            for (sum, code) in sums.iter_mut().zip(codes(&mut bench)) {
                *sum += f64::from(code.counts());
            }
        }
        for (channel, sum) in sums.into_iter().enumerate() {
            let n = f64::from(n);
            // Five standard errors of the mean, and the half count of rounding.
            let bound = 5.0 * bench.sensor().noise_counts()[channel] / n.sqrt() + 0.5;
            assert!((sum / n - expected[channel]).abs() < bound, "channel {channel}");
        }
    }

    #[test]
    fn the_converter_s_data_rate_moves_time() {
        for (ratio, rate) in (0..8_u16).zip(DataRate::ALL.into_iter().rev()) {
            let mut bench = bench(ScenarioKind::Force, 4);
            write(&mut bench, &[0x6180, 0xFF02 | (ratio << 2)]);
            for _ in 0..rate.hertz() {
                assert!(bench.next_conversion());
            }
            assert_eq!(bench.now().as_micros(), 1_000_000);
        }
    }

    #[test]
    fn unused_channels_read_zero() {
        let mut bench = bench(ScenarioKind::Fingertip, 5);
        bench.hang(Load { mass_kg: 0.1114, arm_m: Vector3::zeros() });
        let codes = codes(&mut bench);
        assert!(codes[..4].iter().all(|&code| code != AdcCode::ZERO));
        assert!(codes[4..].iter().all(|&code| code == AdcCode::ZERO));
    }

    #[test]
    fn the_same_seed_gives_the_same_codes() {
        let run = |seed| {
            let mut bench = bench(ScenarioKind::Wrist, seed);
            bench.hang(Load { mass_kg: 2.0, arm_m: Vector3::new(0.1, 0.02, 0.05) });
            bench.turn();
            (0..2000).map(|_| codes(&mut bench)).collect::<Vec<_>>()
        };
        assert_eq!(run(6), run(6));
        assert_ne!(run(6), run(7));
    }

    #[test]
    fn too_much_load_clips_at_the_end_of_24_bits() {
        let mut bench = bench(ScenarioKind::Force, 8);
        bench.hang(Load { mass_kg: 1000.0, arm_m: Vector3::zeros() });
        bench.hold(Vector3::z_axis());
        assert!(codes(&mut bench)[..6].iter().all(|&code| code == AdcCode::MAX));
        bench.hold(-Vector3::z_axis());
        assert!(codes(&mut bench)[..6].iter().all(|&code| code == AdcCode::MIN));
    }

    #[test]
    fn a_sensor_of_one_s_own_is_welcome() {
        let sensor: SoftwareSensor = bench(ScenarioKind::Planar, 9).sensor().clone();
        assert_eq!(Bench::new(sensor.clone(), 1).sensor(), &sensor);
    }
}
