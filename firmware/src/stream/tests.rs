extern crate std;

use std::vec;
use std::vec::Vec;

use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DeviceTime, MAX_DOF, SampleIndex};
use ftcal_shared::wire::{CodesFrame, GageList, InvalidCause, MAX_RUN, Run, ToHost, WrenchFrame};

use super::{
    Batcher, EAGER_PERIOD_NANOS, LONGEST_WAIT_MICROS, Measurement, Moment, SilentMoment, WrenchMoment,
};

fn wrench(index: u32) -> [f32; MAX_DOF] {
    // Whole numbers arrive exactly.
    [(index % 1000) as f32, 2.0, 3.0, 0.0, 0.0, 0.0]
}

/// A stream at this period; what is no wrench is up to the test.
fn sample(index: u32, period_micros: u32) -> WrenchMoment {
    let time = DeviceTime::from_micros(u64::from(index) * u64::from(period_micros));
    WrenchMoment {
        index: SampleIndex::new(index),
        stride: 1,
        time,
        announced: time,
        period_nanos: 1000 * period_micros,
        status: 0,
        parity: None,
        basis: 0,
        measurement: Measurement::Valid { wrench: wrench(index), axes: 3, calibration: 7 },
    }
}

fn invalid(sample: WrenchMoment, cause: InvalidCause) -> WrenchMoment {
    WrenchMoment { measurement: Measurement::Invalid(cause), ..sample }
}

/// What a board sends of these moments, the batcher asked after each one, and once more after the last one's time is up.
fn sent(moments: &[Moment], line_is_idle: bool) -> Vec<(DeviceTime, ToHost)> {
    let mut batcher = Batcher::new();
    let mut sent = Vec::new();
    let mut now = DeviceTime::default();
    let mut ask = |now, mut moment: Option<Moment>| {
        while let Some(message) = batcher.next(now, line_is_idle, || moment.take()) {
            sent.push((now, message));
        }
    };
    for moment in moments {
        if let Moment::Wrench(sample) = moment {
            now = sample.announced;
        }
        ask(now, Some(moment.clone()));
    }
    ask(DeviceTime::from_micros(now.as_micros() + LONGEST_WAIT_MICROS), None);
    sent
}

fn frames(moments: &[Moment], line_is_idle: bool) -> Vec<WrenchFrame> {
    let frame = |(_, message)| match message {
        ToHost::Wrench(frame) => frame,
        other => panic!("{other:?} is no wrench frame"),
    };
    sent(moments, line_is_idle).into_iter().map(frame).collect()
}

fn samples_of(frame: &WrenchFrame) -> usize {
    match &frame.run {
        Run::Valid { wrenches, .. } => wrenches.count().expect("whole wrenches"),
        Run::Invalid { samples, .. } => usize::from(*samples),
    }
}

#[test]
fn every_sample_arrives_once_in_its_place_whatever_is_between() {
    // At 8000 a second; every so often a lost sample, and saturated ones.
    let mut moments = Vec::new();
    let mut expected = Vec::new();
    for index in 0..1000 {
        if index % 97 == 13 {
            continue;
        }
        let mut moment = sample(index, 125);
        if index % 50 > 47 {
            moment = invalid(moment, InvalidCause::Saturated(1 << (index % 50 % 2)));
        }
        let valid = matches!(moment.measurement, Measurement::Valid { .. });
        expected.push((index, valid.then(|| wrench(index))));
        moments.push(Moment::Wrench(moment));
    }
    let mut arrived = Vec::new();
    for frame in frames(&moments, true) {
        assert!((1..=MAX_RUN).contains(&samples_of(&frame)));
        let samples = u32::try_from(samples_of(&frame)).expect("at most twenty");
        assert_eq!(u64::from(frame.first.get()) * 125, frame.time.as_micros());
        assert_eq!(frame.span_micros, (samples - 1) * 125);
        match &frame.run {
            Run::Valid { calibration, wrenches, .. } => {
                assert_eq!((*calibration, wrenches.axes()), (7, 3));
                arrived.extend((frame.first.get()..).zip(wrenches.wrenches().map(Some)));
            }
            Run::Invalid { .. } => arrived.extend((frame.first.get()..).zip((0..samples).map(|_| None))),
        }
    }
    assert_eq!(arrived, expected);
}

#[test]
fn a_run_ends_where_anything_changes() {
    let next = sample(1, 125);
    let Measurement::Valid { wrench, .. } = next.measurement else { panic!("a wrench") };
    let other_calibration = Measurement::Valid { wrench, axes: 3, calibration: 8 };
    let saturated = InvalidCause::Saturated(1);
    for (one, other) in [
        (sample(0, 125), invalid(next, InvalidCause::Uncalibrated)),
        (invalid(sample(0, 125), saturated), invalid(next, InvalidCause::Saturated(2))),
        (invalid(sample(0, 125), saturated), next),
        (sample(0, 125), WrenchMoment { measurement: other_calibration, ..next }),
        (sample(0, 125), WrenchMoment { index: SampleIndex::new(2), ..next }),
        (sample(0, 125), WrenchMoment { index: SampleIndex::new(0), ..next }),
        (sample(0, 125), WrenchMoment { stride: 2, ..next }),
        // More than half a period early or late.
        (sample(0, 125), WrenchMoment { time: DeviceTime::from_micros(62), ..next }),
        (sample(0, 125), WrenchMoment { time: DeviceTime::from_micros(188), ..next }),
    ] {
        assert_eq!(frames(&[Moment::Wrench(one), Moment::Wrench(other)], false).len(), 2, "{other:?}");
    }
    assert_eq!(frames(&[Moment::Wrench(sample(0, 125)), Moment::Wrench(next)], false).len(), 1);
}

#[test]
fn runs_are_full_at_the_highest_rates_and_no_sample_waits_for_long_at_any() {
    for period in [31, 62, 125, 250, 500, 1000, 2000, 4000] {
        let moments: Vec<_> = (0..400).map(|index| Moment::Wrench(sample(index, period))).collect();
        for line_is_idle in [false, true] {
            let sent = sent(&moments, line_is_idle);
            // The last one was given up waiting for.
            for (at, message) in &sent[..sent.len() - 1] {
                let ToHost::Wrench(frame) = message else { panic!("{message:?}") };
                let waited = at.as_micros() - frame.time.as_micros();
                assert!(waited <= LONGEST_WAIT_MICROS, "{waited} µs at {period} µs");
                assert_eq!(
                    at.as_micros() - frame.time.as_micros(),
                    u64::from(frame.span_micros + frame.age_micros)
                );
                if period <= 250 {
                    assert_eq!(samples_of(frame), MAX_RUN);
                } else if 1000 * period >= EAGER_PERIOD_NANOS && line_is_idle {
                    assert_eq!((samples_of(frame), frame.age_micros), (1, 0));
                }
            }
        }
    }
}

#[test]
fn a_frame_tells_the_worst_of_its_samples() {
    let with = |index, status, parity| Moment::Wrench(WrenchMoment { status, parity, ..sample(index, 125) });
    let moments = [with(0, 1, Some(2.0)), with(1, 0, Some(5.0)), with(2, 8, None), with(3, 1, Some(3.0))];
    let [frame] = &frames(&moments, false)[..] else { panic!("one frame") };
    let Run::Valid { parity, .. } = frame.run else { panic!("wrenches") };
    assert_eq!((frame.status, parity), (0b1001, Some(5.0)));
    // What is no number is the worst.
    let moments = [with(0, 1, Some(f32::NAN)), with(1, 0, Some(5.0))];
    let Run::Valid { parity, .. } = frames(&moments, false)[0].run else { panic!("wrenches") };
    assert!(parity.is_some_and(f32::is_nan));
}

#[test]
fn raw_samples_and_silences_go_at_once_and_in_order() {
    let codes = CodesFrame {
        index: SampleIndex::new(5),
        time: DeviceTime::from_micros(5),
        codes: GageList::from_slice(&[AdcCode::MAX]).expect("one"),
    };
    let cause = InvalidCause::Adc(AdcFault::NotResponding);
    let silence =
        SilentMoment { next: SampleIndex::new(3), time: DeviceTime::from_micros(100), status: 9, cause };
    let moments = [
        Moment::Wrench(sample(0, 125)),
        Moment::Codes(codes.clone()),
        Moment::Silence(silence),
        Moment::Silence(silence),
        Moment::Wrench(sample(3, 125)),
    ];
    let sent: Vec<_> = sent(&moments, false).into_iter().map(|(_, message)| message).collect();
    let [ToHost::Wrench(first), ToHost::Codes(second), ToHost::Wrench(third), fourth, ToHost::Wrench(fifth)] =
        &sent[..]
    else {
        panic!("{sent:?}")
    };
    assert_eq!((samples_of(first), second, samples_of(fifth)), (1, &codes, 1));
    assert_eq!(
        (&third.run, third.first, third.status),
        (&Run::Invalid { cause, samples: 0 }, silence.next, 9)
    );
    assert_eq!(fourth, &ToHost::Wrench(third.clone()));
}

#[test]
fn what_is_forgotten_does_not_come_back() {
    let mut batcher = Batcher::new();
    let mut moments = vec![Moment::Wrench(sample(0, 125)), Moment::Wrench(sample(7, 125))].into_iter();
    let now = DeviceTime::default();
    assert!(batcher.next(now, false, || moments.next()).is_some());
    batcher.clear();
    let later = DeviceTime::from_micros(1_000_000);
    assert_eq!(batcher.next(later, true, || None), None);
}
