use super::{MAX_RUN, PackedWrenches, Run, WrenchFrame};
use crate::units::{DeviceTime, MAX_DOF, SampleIndex};
use crate::wire::frame::{Decoder, encode};
use crate::wire::{InvalidCause, ToHost};

/// Numbers of every size and sign: any bits that are a number that can be sent.
fn numbers(seed: u32) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || loop {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let number = f32::from_bits(state.rotate_left(13));
        if PackedWrenches::can_hold(&[number; MAX_DOF]) {
            return number;
        }
    }
}

fn largest(wrenches: &[[f32; MAX_DOF]], axis: usize) -> f64 {
    wrenches.iter().map(|wrench| f64::from(wrench[axis]).abs()).fold(0.0, f64::max)
}

#[test]
fn no_number_is_off_by_more_than_its_bound() {
    for seed in 0..2000 {
        let mut number = numbers(seed);
        // Once numbers of all sizes in one run, once numbers of one size, as a sensor has them.
        let scale = number();
        let like_a_sensor = seed % 2 == 0;
        let mut next =
            || if like_a_sensor { scale * ((number().to_bits() % 1000) as f32 * 1e-3) } else { number() };
        let wrenches: [[f32; MAX_DOF]; MAX_RUN] = core::array::from_fn(|_| core::array::from_fn(|_| next()));
        let packed = PackedWrenches::pack(MAX_DOF, &wrenches).expect("they fit");
        assert_eq!((packed.axes(), packed.count()), (MAX_DOF, Some(MAX_RUN)));
        for (wrench, unpacked) in wrenches.iter().zip(packed.wrenches()) {
            for axis in 0..MAX_DOF {
                let error = (f64::from(wrench[axis]) - f64::from(unpacked[axis])).abs();
                let bound = largest(&wrenches, axis) / f64::from(1 << 23);
                assert!(error <= bound, "{} became {}", wrench[axis], unpacked[axis]);
            }
        }
    }
}

#[test]
fn what_needs_no_more_than_the_unit_arrives_exactly() {
    let ends =
        [f32::from_bits(1), f32::MIN_POSITIVE, 1.0, -1.0, 16_777_215.0, f32::from_bits((254 << 23) - 2)];
    for number in ends {
        let packed = PackedWrenches::pack(1, &[[number; MAX_DOF], [0.0; MAX_DOF]]).expect("they fit");
        // A number of 24 bits loses its last.
        let allowed = if number == 16_777_215.0 { 1.0 } else { 0.0 };
        let mut unpacked = packed.wrenches();
        let [first, beyond @ ..] = unpacked.next().expect("two were packed");
        assert!((first - number).abs() <= allowed, "{number:e} became {first:e}");
        assert_eq!((beyond, unpacked.next()), ([0.0; MAX_DOF - 1], Some([0.0; MAX_DOF])));
    }
}

#[test]
fn what_cannot_be_sent_is_not_packed() {
    for number in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::from_bits(254 << 23)] {
        let wrench = [0.0, 0.0, 0.0, 0.0, 0.0, number];
        assert!(!PackedWrenches::can_hold(&wrench));
        assert_eq!(PackedWrenches::pack(MAX_DOF, &[[0.0; MAX_DOF], wrench]), None);
    }
    assert_eq!(PackedWrenches::pack(MAX_DOF, &[[0.0; MAX_DOF]; MAX_RUN + 1]), None);
    assert_eq!(PackedWrenches::pack(MAX_DOF + 1, &[[0.0; MAX_DOF]]), None);
}

#[test]
fn bytes_that_are_no_wrenches_are_told() {
    let two_axes = PackedWrenches::pack(2, &[[1.0; MAX_DOF]]).expect("they fit");
    let three_axes = PackedWrenches::pack(3, &[[1.0; MAX_DOF]]).expect("they fit");
    let torn = PackedWrenches { exponents: two_axes.exponents, mantissas: three_axes.mantissas.clone() };
    assert_eq!(torn.count(), None);
    let without_axes = PackedWrenches { exponents: heapless::Vec::new(), mantissas: three_axes.mantissas };
    assert_eq!(without_axes.count(), None);
    // Whatever they are, to look at them is safe.
    assert_eq!((torn.wrenches().count(), without_axes.wrenches().count()), (1, 9));
}

/// A frame whose every field takes as many bytes as it can.
fn longest(wrenches: &[[f32; MAX_DOF]]) -> WrenchFrame {
    WrenchFrame {
        first: SampleIndex::new(u32::MAX),
        stride: u8::MAX,
        time: DeviceTime::from_micros(u64::MAX),
        span_micros: u32::MAX,
        age_micros: u32::MAX,
        status: u16::MAX,
        temperature_centi_celsius: Some(i16::MIN),
        run: Run::Valid {
            calibration: u32::MAX,
            parity: Some(f32::MAX),
            wrenches: PackedWrenches::pack(MAX_DOF, wrenches).expect("they fit"),
        },
    }
}

#[test]
fn a_full_frame_is_at_most_a_quarter_longer_than_its_numbers_and_fits_on_the_line() {
    /// Bytes a second at 2 Mbaud, ten bits each.
    const LINE: usize = 200_000;
    const RATE: usize = 8_000;
    let mut number = numbers(1);
    let wrenches: [[f32; MAX_DOF]; MAX_RUN] = core::array::from_fn(|_| core::array::from_fn(|_| number()));
    let message = ToHost::Wrench(longest(&wrenches));
    let bytes = encode(&message).expect("it fits").len();
    let numbers = MAX_RUN * MAX_DOF * 3;
    assert!(bytes * 4 <= numbers * 5, "{bytes} bytes for {numbers} bytes of numbers");
    assert!(bytes * RATE / MAX_RUN <= LINE, "{bytes} bytes, {} times a second", RATE / MAX_RUN);
    // As the module says of it.
    assert!(bytes - numbers <= 60 && bytes * 100 <= numbers * 117, "{bytes}");
}

#[test]
fn frames_arrive_as_they_were_sent() {
    let mut number = numbers(2);
    let wrenches: [[f32; MAX_DOF]; MAX_RUN] = core::array::from_fn(|_| core::array::from_fn(|_| number()));
    let full = longest(&wrenches);
    let invalid = Run::Invalid { cause: InvalidCause::Saturated(u16::MAX), samples: 255 };
    for frame in [longest(&wrenches[..1]), WrenchFrame { run: invalid, ..full.clone() }, full] {
        let message = ToHost::Wrench(frame);
        let bytes = encode(&message).expect("it fits");
        let mut decoder = Decoder::new();
        let arrived = bytes.iter().find_map(|&byte| decoder.push::<ToHost>(byte));
        assert_eq!(arrived, Some(Ok(message)));
    }
}
