use ftcal_shared::units::AdcCode;
use nalgebra::Vector3;

use super::{ActiveFaults, Fault, Rail};
use crate::simulator::bench::tests::{bench, codes, frame, write};
use crate::simulator::bench::{Bench, Load};
use crate::simulator::scenario::ScenarioKind;
use crate::simulator::sensor::FULL_SCALE_COUNTS;

fn turning_bench() -> Bench {
    let mut bench = bench(ScenarioKind::Force, 11);
    bench.hang(Load { mass_kg: 1.5, arm_m: Vector3::zeros() });
    bench.turn();
    bench
}

/// Channel 2 of a bench with this fault beside the same channel without; every other channel must be untouched.
fn with_and_without(fault: Fault, conversions: usize) -> Vec<(AdcCode, AdcCode)> {
    let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
    faulty.inject(fault);
    (0..conversions)
        .map(|_| {
            let (with, without) = (codes(&mut faulty), codes(&mut healthy));
            for channel in (0..8).filter(|&channel| channel != 2) {
                assert_eq!(with[channel], without[channel]);
            }
            (with[2], without[2])
        })
        .collect()
}

#[test]
fn a_stuck_channel_repeats_one_reading() {
    let pairs = with_and_without(Fault::StuckChannel { channel: 2 }, 1000);
    assert!(pairs.iter().all(|&(with, _)| with == pairs[0].1));
}

#[test]
fn a_saturated_channel_stands_at_its_rail() {
    for (rail, end) in [(Rail::Low, AdcCode::MIN), (Rail::High, AdcCode::MAX)] {
        let pairs = with_and_without(Fault::SaturatedChannel { channel: 2, rail }, 100);
        assert!(pairs.iter().all(|&(with, _)| with == end));
    }
}

#[test]
fn a_noisy_channel_carries_that_much_more_noise() {
    let noise_counts = 20_000.0;
    let pairs = with_and_without(Fault::NoisyChannel { channel: 2, noise_counts }, 5000);
    let n = pairs.len() as f64;
    let squares = pairs.iter().map(|(with, without)| {
        let extra = f64::from(with.counts() - without.counts());
        extra * extra
    });
    let variance = squares.sum::<f64>() / n;
    let expected = noise_counts * noise_counts;
    assert!((variance - expected).abs() < 5.0 * 2.0_f64.sqrt() * expected / n.sqrt());
}

#[test]
fn an_open_channel_wanders_whatever_the_load() {
    let pairs = with_and_without(Fault::OpenChannel { channel: 2 }, 60_000);
    let relative = pairs.iter().map(|(with, _)| f64::from(with.counts()) / FULL_SCALE_COUNTS);
    let (low, high) = relative.clone().fold((1.0, -1.0), |(low, high), x| (x.min(low), x.max(high)));
    assert!(low < -0.3 && high > 0.3, "{low} to {high}");
    let inside = pairs.iter().filter(|(with, _)| !with.is_saturated()).count();
    assert!(inside > 59_000, "{inside}");
}

#[test]
fn bits_flip_at_their_rate_in_both_directions() {
    let probability = 0.01;
    let mut faults = ActiveFaults::none(12);
    faults.inject(Fault::BusBitErrors { probability });
    let (mut command, mut reply) = (vec![0x5A_u8; 10_000], vec![0x5A; 10_000]);
    faults.disturb_command(&mut command);
    faults.disturb_reply(&mut reply);
    assert_ne!(command, reply);
    for bytes in [command, reply] {
        let flipped: u32 = bytes.iter().map(|byte| (byte ^ 0x5A).count_ones()).sum();
        // Five standard deviations of the binomial distribution.
        let expected = 80_000.0 * probability;
        assert!((f64::from(flipped) - expected).abs() < 5.0 * expected.sqrt(), "{flipped} of {expected}");
    }
}

#[test]
fn bit_errors_reach_the_frames_and_end() {
    let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
    faulty.inject(Fault::BusBitErrors { probability: 0.5 });
    assert_ne!(frame(&mut faulty), frame(&mut healthy));
    faulty.clear_faults();
    assert_eq!(codes(&mut faulty), codes(&mut healthy));
}

#[test]
fn data_ready_is_lost_as_often_as_asked_and_the_data_are_not() {
    let mut bench = turning_bench();
    bench.inject(Fault::DataReadyLost { probability: 0.25 });
    let n = 10_000;
    let announced = (0..n).filter(|_| bench.next_conversion()).count();
    // Five standard deviations of the binomial distribution.
    assert!((announced as f64 - 7500.0).abs() < 5.0 * (10_000.0_f64 * 0.25 * 0.75).sqrt());
    bench.inject(Fault::DataReadyLost { probability: 1.0 });
    assert!((0..100).all(|_| !bench.next_conversion()));
    assert_ne!(codes(&mut bench)[0], AdcCode::ZERO);
}

#[test]
fn a_late_reply_is_the_one_before() {
    let (mut late, mut prompt) = (turning_bench(), turning_bench());
    let mut previous = frame(&mut late);
    assert_eq!(frame(&mut prompt), previous);
    late.inject(Fault::LateReply);
    for _ in 0..50 {
        assert_eq!(frame(&mut late), previous);
        previous = frame(&mut prompt);
    }
}

#[test]
fn a_wrong_identity_reads_until_cleared() {
    let mut bench = turning_bench();
    bench.inject(Fault::WrongIdentity { id: 0x2400 });
    write(&mut bench, &[0xA000]);
    assert_eq!(frame(&mut bench)[0], [0x24, 0x00, 0]);
    bench.clear_faults();
    write(&mut bench, &[0xA000]);
    assert_eq!(frame(&mut bench)[0][0], 0x28);
}

#[test]
fn a_missing_converter_is_a_silent_bus() {
    let mut bench = turning_bench();
    bench.inject(Fault::ConverterMissing);
    assert!((0..10).all(|_| !bench.next_conversion()));
    assert!(frame(&mut bench).as_flattened().iter().all(|&byte| byte == 0xFF));
    bench.clear_faults();
    assert!(bench.next_conversion());
}

#[test]
fn a_channel_that_does_not_exist_disturbs_nothing() {
    let (mut faulty, mut healthy) = (turning_bench(), turning_bench());
    faulty.inject(Fault::SaturatedChannel { channel: 8, rail: Rail::High });
    assert_eq!(codes(&mut faulty), codes(&mut healthy));
}

#[test]
fn a_drifting_channel_is_off_by_its_rate_times_the_time() {
    let counts_per_second = 50_000.0;
    let pairs = with_and_without(Fault::DriftingChannel { channel: 2, counts_per_second }, 1000);
    for (conversion, (with, without)) in (1..).zip(&pairs) {
        let expected = counts_per_second * 1e-3 * f64::from(conversion);
        // Both codes are rounded.
        assert!((f64::from(with.counts() - without.counts()) - expected).abs() <= 1.0);
    }
}

#[test]
fn a_debonded_channel_feels_its_share_and_a_dead_one_nothing() {
    let whole = with_and_without(Fault::DebondedChannel { channel: 2, kept: 0.0 }, 200);
    let half = with_and_without(Fault::DebondedChannel { channel: 2, kept: 0.5 }, 200);
    for ((none, all), (half, _)) in whole.iter().zip(&half) {
        let middle = f64::midpoint(none.counts().into(), all.counts().into());
        assert!((f64::from(half.counts()) - middle).abs() <= 1.0);
    }
    let bias = turning_bench().sensor().bias_counts()[2];
    let noise = turning_bench().sensor().noise_counts()[2];
    assert!(whole.iter().all(|(with, _)| (f64::from(with.counts()) - bias).abs() < 6.0 * noise + 1.0));
    let dead = with_and_without(Fault::DeadChannel { channel: 2 }, 200);
    assert!(dead.iter().all(|(with, _)| with.counts().abs() < 1000));
}
