//! What the whole sample path costs, from data-ready to a wrench that waits for its frame: the converter is a model behind the bus whose
//! replies are ready, so that all is counted but the bus itself, whose time is the same whatever the processor does.

use core::cell::RefCell;
use core::hint::black_box;

use cortex_m_semihosting::hprintln;
use embedded_hal::spi::SpiDevice;
use ftcal_firmware::acquisition::Acquisition;
use ftcal_firmware::adc::FRAME_BYTES;
use ftcal_firmware::handover::Reading;
use ftcal_firmware::polled::NoDelay;
use ftcal_firmware::sensor::{LinkCounters, Reaction, Sensor};
use ftcal_firmware::storage::job::{StoreJob, Stored};
use ftcal_firmware::stream::{Batcher, Moment};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::{DataRate, DeviceTime, Dof, Gain};
use ftcal_shared::wire::frame::encode;
use ftcal_shared::wire::{CalibrationUpload, ClockSource, GageList, Request, StreamKind};
use heapless::spsc::Queue;

use super::converter::{Bus, Converter};
use super::{Counter, GAGES, HIGHER, codes, matrix, ticks};

/// Samples in all: the first quarter teaches the noise, the next is without a trial, the rest with one.
const SAMPLES: u32 = 8000;
const LEARNING: u32 = SAMPLES / 4;
const TRIAL_FROM: u32 = SAMPLES / 2;

/// Samples between two ticks.
const SAMPLES_PER_TICK: u32 = 8;

const RATE: DataRate = DataRate::Hz4000;

/// Sum and maximum.
#[derive(Default)]
struct Cost {
    samples: u32,
    sum: u32,
    most: u32,
}

impl Cost {
    fn add(&mut self, ticks: u32) {
        self.samples += 1;
        self.sum += ticks;
        self.most = self.most.max(ticks);
    }

    fn mean(&self, counter: &Counter) -> f64 {
        counter.instructions(self.sum) / f64::from(self.samples.max(1))
    }
}

type Subject = Sensor<&'static mut Bins<GAGES, HIGHER>, GAGES, HIGHER>;

#[inline(never)]
pub(crate) fn measure(counter: &Counter, bins: &'static mut Bins<GAGES, HIGHER>) {
    let converter = RefCell::new(Converter::new());
    let mut acquisition = Acquisition::<_, GAGES>::new(Bus(&converter));
    let mut sensor = Subject::new(bins, ClockSource::Simulated);
    ask(&mut sensor, Request::ConfigureAdc(RATE, Gain::X128));
    sensor.exchange(&mut acquisition);
    let now = DeviceTime::from_micros(1_000_000);
    acquisition.tick(now, &mut NoDelay);
    ask(&mut sensor, Request::UploadCalibration(upload()));
    ask(&mut sensor, Request::Stream(StreamKind::Wrench));

    let mut readings = Queue::<Reading<GAGES>, 16>::new();
    let (mut readings_in, mut readings_out) = readings.split();
    let mut moments = Queue::<Moment, 32>::new();
    let mut batcher = Batcher::new();
    let (mut alone, mut with_trial, mut framing, mut held) =
        (Cost::default(), Cost::default(), Cost::default(), 0);
    let (mut bus, mut bare) = (Cost::default(), Bus(&converter));
    let (mut received, sent) = ([0; FRAME_BYTES], [0; FRAME_BYTES]);
    let mut wrenches = 0;
    for sample in 0..SAMPLES {
        if sample == TRIAL_FROM {
            ask(&mut sensor, Request::StartTrial { rank: 3 });
        }
        let micros = 1_000_000 + u64::from(sample + 1) * u64::from(1_000_000 / RATE.hertz());
        let now = DeviceTime::from_micros(micros);
        converter.borrow_mut().convert(&codes(sample));
        let path = ticks(|| {
            let reading = acquisition.on_data_ready(black_box(now), black_box(now));
            if let Some(reading) = reading
                && readings_in.enqueue(*reading).is_err()
            {
                acquisition.note_overrun();
            }
            while let Some(reading) = readings_out.peek() {
                if let Some(moment) = sensor.take_in(reading, now) {
                    let _ = moments.enqueue(moment);
                }
                let _ = readings_out.dequeue();
            }
        });
        wrenches += moments.len();
        if sample >= TRIAL_FROM {
            with_trial.add(path);
        } else if sample >= LEARNING {
            alone.add(path);
        }
        framing.add(ticks(|| {
            if let Some(message) = batcher.next(now, true, || moments.dequeue()) {
                let _ = black_box(encode(&message));
            }
        }));
        if sample % SAMPLES_PER_TICK == 0 {
            held = held.max(ticks(|| sensor.exchange(black_box(&mut acquisition))));
            let _ = sensor.tick(now);
        }
    }
    for sample in 0..LEARNING {
        converter.borrow_mut().convert(&codes(sample));
        bus.add(ticks(|| {
            let _ = black_box(&mut bare).transfer(black_box(&mut received), black_box(&sent));
        }));
    }
    assert!(wrenches == SAMPLES as usize, "every sample came through");
    hprintln!("path_bus {:.0}", bus.mean(counter));
    hprintln!("path_mean {:.0}", alone.mean(counter));
    hprintln!("path_worst {:.0}", counter.instructions(alone.most));
    hprintln!("path_with_trial_mean {:.0}", with_trial.mean(counter));
    hprintln!("path_with_trial_worst {:.0}", counter.instructions(with_trial.most));
    hprintln!("frame_mean {:.0}", framing.mean(counter));
    hprintln!("data_ready_held {:.0}", counter.instructions(held));
}

/// Has a request answered, and a trial started without checkpoints.
fn ask(sensor: &mut Subject, request: Request) {
    let now = DeviceTime::from_micros(1_000_000);
    if let Reaction::Store(StoreJob::PrepareTrial { rank, .. }) =
        sensor.answer(request, now, LinkCounters::default())
    {
        let _ = sensor.finish_storing(Stored::Prepared { rank });
    }
}

fn upload() -> CalibrationUpload {
    let bias_counts = GageList::from_slice(&[10_000.5; GAGES]).unwrap_or_default();
    let matrix = matrix().into_iter().collect();
    let mut upload = CalibrationUpload {
        dof: Dof::SpatialForceTorque,
        gain: Gain::X128,
        bias_counts,
        matrix,
        identity: 0,
    };
    upload.identity = upload.identity_of_numbers();
    upload
}
