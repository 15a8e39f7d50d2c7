//! What passes between the interrupt that reads the converter and those that make something of what it reads.
//!
//! Data-ready has to be answered at once, and what is made of a conversion can wait for some others. So the converter
//! ([`Acquisition`]) belongs to the interrupt alone, and is lent to nobody for longer than it takes to copy a few words:
//!
//! ```text
//! Acquisition ──Reading, one a conversion, in a queue──► Sensor
//!             ◄──Orders: all that is wanted of it──────┐
//!             ───Report: all that is known of it───────┴ RemoteConverter, in the sensor
//! ```
//!
//! Orders and report change hands together (`RemoteConverter::exchange`). Every order begins a new **era**, and a reading bears the
//! era in which it was made: what was read before an order is never taken for what came of it.

use embedded_hal::spi::SpiDevice;
use ftcal_shared::fault::AdcFault;
use ftcal_shared::units::{AdcCode, DataRate, DeviceTime, Gain, SampleIndex};
use ftcal_shared::wire::AdcState;

use crate::acquisition::{Acquisition, ConversionCounters, Sample};
use crate::adc::{AdcSettings, ChannelMask, Input};
use crate::health::Injection;

/// What became of one conversion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading<const GAGES: usize> {
    /// Left over from some conversion before where there was a fault, and not to be looked at then: see [`Reading::outcome`].
    pub(crate) sample: Sample<GAGES>,
    pub(crate) fault: Option<AdcFault>,
    /// Number of the conversion; lost and corrupted conversions have taken a number, too.
    pub index: SampleIndex,
    /// When it was announced.
    pub announced: DeviceTime,
    /// What the board's clock said then.
    pub read_at: DeviceTime,
    /// See the module.
    pub(crate) era: u8,
}

impl<const GAGES: usize> Reading<GAGES> {
    /// A reading still to be made: no sample.
    pub(crate) const NONE: Self = Self {
        sample: Sample { codes: [AdcCode::ZERO; GAGES], repeating: 0, after_gap: false },
        fault: Some(AdcFault::NotResponding),
        index: SampleIndex::new(0),
        announced: DeviceTime::from_micros(0),
        read_at: DeviceTime::from_micros(0),
        era: 0,
    };

    /// The sample, or why this conversion is none.
    ///
    /// # Errors
    ///
    /// That fault.
    pub const fn outcome(&self) -> Result<&Sample<GAGES>, AdcFault> {
        match self.fault {
            None => Ok(&self.sample),
            Some(fault) => Err(fault),
        }
    }
}

/// All that is wanted of the converter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Orders {
    /// How it is to be set up, from this era on.
    pub(crate) settings: AdcSettings,
    /// Changes with every order.
    pub(crate) era: u8,
    /// Changes where the converter is to be started, again or otherwise.
    pub(crate) start: u8,
    /// What is played on its bus.
    pub(crate) injection: Option<Injection>,
    /// Data-ready is not to be attended to.
    pub(crate) ignore_data_ready: bool,
}

impl Orders {
    /// Of a converter that is still to be started.
    pub(crate) fn new(channels: ChannelMask) -> Self {
        Self {
            settings: AdcSettings { channels, ..AdcSettings::default() },
            era: 0,
            start: 0,
            injection: None,
            ignore_data_ready: false,
        }
    }
}

/// All that is known of the converter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Report {
    pub(crate) state: AdcState,
    pub(crate) counters: ConversionCounters,
    /// The number that the next conversion gets.
    pub(crate) next_index: SampleIndex,
}

/// The converter, for those who do not have it: what was ordered, and what was last reported.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RemoteConverter {
    orders: Orders,
    report: Report,
}

impl RemoteConverter {
    pub(crate) fn new(channels: ChannelMask) -> Self {
        let report = Report {
            state: AdcState::Starting,
            counters: ConversionCounters::default(),
            next_index: SampleIndex::default(),
        };
        Self { orders: Orders::new(channels), report }
    }

    /// Hands the orders over, and takes the report. Both are but a few words: the interrupt that reads the converter may have
    /// to wait for it.
    pub(crate) fn exchange<Spi: SpiDevice<u8>, const GAGES: usize>(
        &mut self,
        acquisition: &mut Acquisition<Spi, GAGES>,
    ) {
        self.report = acquisition.follow(self.orders);
    }

    /// Rate, gain and input asked for.
    pub(crate) const fn settings(&self) -> &AdcSettings {
        &self.orders.settings
    }

    /// The state as last reported; starting, once a start was ordered.
    pub(crate) const fn state(&self) -> AdcState {
        self.report.state
    }

    pub(crate) const fn counters(&self) -> ConversionCounters {
        self.report.counters
    }

    /// The number that the next conversion gets.
    pub(crate) const fn next_index(&self) -> SampleIndex {
        self.report.next_index
    }

    /// Whether this was read as ordered now, and not before.
    pub(crate) const fn is_current<const GAGES: usize>(&self, reading: &Reading<GAGES>) -> bool {
        reading.era == self.orders.era
    }

    /// Asks for another rate and gain.
    pub(crate) const fn configure(&mut self, data_rate: DataRate, gain: Gain) {
        self.orders.settings.data_rate = data_rate;
        self.orders.settings.gain = gain;
        self.restart();
    }

    /// Has the converter measure something else.
    pub(crate) const fn connect(&mut self, input: Input) {
        self.orders.settings.input = input;
        self.restart();
    }

    /// Has the converter started.
    pub(crate) const fn restart(&mut self) {
        self.begin_era();
        self.orders.start = self.orders.start.wrapping_add(1);
        self.report.state = AdcState::Starting;
    }

    /// Plays a fault on the converter's bus, or none.
    pub(crate) const fn play(&mut self, injection: Option<Injection>) {
        self.begin_era();
        self.orders.injection = injection;
    }

    /// Has data-ready attended to, or not.
    pub(crate) const fn ignore_data_ready(&mut self, ignore: bool) {
        self.begin_era();
        self.orders.ignore_data_ready = ignore;
    }

    const fn begin_era(&mut self) {
        self.orders.era = self.orders.era.wrapping_add(1);
    }
}
