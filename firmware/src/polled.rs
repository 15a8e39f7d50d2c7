//! A sensor together with its converter, where nothing interrupts: in the simulator and in tests.
//!
//! The board reads the converter in one interrupt and has the sensor make something of it in another. Here the one follows the other
//! at once, so that no reading waits and none is lost. Orders and report change hands at ticks, as they do there.

use core::ops::DerefMut;

use embedded_hal::delay::DelayNs;
use embedded_hal::spi::{ErrorKind, ErrorType, Operation, SpiDevice};
use ftcal_shared::estimation::bins::Bins;
use ftcal_shared::units::DeviceTime;
use ftcal_shared::wire::ClockSource;

use crate::acquisition::Acquisition;
use crate::sensor::Sensor;
use crate::stream::Moment;

/// A bus with nothing on it: the converter of a sensor that needs none.
pub struct EmptyBus;

impl ErrorType for EmptyBus {
    type Error = ErrorKind;
}

impl SpiDevice for EmptyBus {
    fn transaction(&mut self, _operations: &mut [Operation<'_, u8>]) -> Result<(), ErrorKind> {
        Err(ErrorKind::Other)
    }
}

/// Waits for nothing: where time does not pass, or is somebody else's.
pub struct NoDelay;

impl DelayNs for NoDelay {
    fn delay_ns(&mut self, _nanoseconds: u32) {}
}

/// A converter with `GAGES` of its channels in use, and the sensor that makes something of it.
pub struct PolledSensor<Spi, Store, const GAGES: usize, const HIGHER: usize> {
    acquisition: Acquisition<Spi, GAGES>,
    /// The sensor, to be asked and answered.
    pub sensor: Sensor<Store, GAGES, HIGHER>,
}

impl<Spi, Store, const GAGES: usize, const HIGHER: usize> PolledSensor<Spi, Store, GAGES, HIGHER>
where
    Spi: SpiDevice<u8>,
    Store: DerefMut<Target = Bins<GAGES, HIGHER>>,
{
    /// An uncalibrated sensor whose converter the first [`PolledSensor::tick`] starts.
    pub fn new(spi: Spi, store: Store, clock: ClockSource) -> Self {
        Self { acquisition: Acquisition::new(spi), sensor: Sensor::new(store, clock) }
    }

    /// See [`Acquisition::count_on`].
    pub fn count_on(&mut self) {
        self.acquisition.count_on();
    }

    /// See [`Acquisition::tick`] and [`Sensor::tick`].
    pub fn tick(&mut self, now: DeviceTime, delay: &mut impl DelayNs) -> Option<Moment> {
        self.acquisition.tick(now, delay);
        self.sensor.exchange(&mut self.acquisition);
        self.sensor.tick(now)
    }

    /// See [`Acquisition::on_data_ready`] and [`Sensor::take_in`].
    pub fn on_data_ready(&mut self, now: DeviceTime, announced: DeviceTime) -> Option<Moment> {
        let reading = self.acquisition.on_data_ready(now, announced)?;
        self.sensor.take_in(reading, now)
    }
}
