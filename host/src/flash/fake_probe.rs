//! Probes for the tests that probe-rs' own fake does not play: several at once, and one with no chip behind it.

use std::fmt;

use probe_rs::integration::FakeProbe;
use probe_rs::probe::list::{Lister, ProbeListItem, ProbeLister};
use probe_rs::probe::{
    DebugProbe, DebugProbeError, DebugProbeInfo, DebugProbeSelector, Probe, ProbeCreationError, ProbeFactory,
    WireProtocol,
};

/// A lister that finds one probe of one kind for each serial number.
pub(super) fn lister_of(serial_numbers: &[&str]) -> Lister {
    let probes = serial_numbers.iter().map(|serial_number| {
        let serial_number = Some((*serial_number).to_owned());
        DebugProbeInfo::new("probe", 0x0483, 0x374b, serial_number, &FakeFactory, None, false)
    });
    Lister::with_lister(Box::new(FakeLister(probes.collect())))
}

#[derive(Debug)]
struct FakeLister(Vec<DebugProbeInfo>);

impl ProbeLister for FakeLister {
    fn open(&self, selector: &DebugProbeSelector) -> Result<Probe, DebugProbeError> {
        match self.0.iter().find(|probe| selector.matches_probe(probe)) {
            Some(_) => Ok(FakeProbe::with_mocked_core().into_probe()),
            None => Err(ProbeCreationError::NotFound.into()),
        }
    }

    fn list_with_access(&self, selector: Option<&DebugProbeSelector>) -> Vec<ProbeListItem> {
        let matching =
            self.0.iter().filter(|probe| selector.is_none_or(|wanted| wanted.matches_probe(probe)));
        matching.cloned().map(ProbeListItem::accessible).collect()
    }
}

/// What the info of a probe refers to; never asked, as the lister opens the probes.
#[derive(Debug)]
struct FakeFactory;

impl fmt::Display for FakeFactory {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("fake")
    }
}

impl ProbeFactory for FakeFactory {
    fn open(&self, _: &DebugProbeSelector) -> Result<Box<dyn DebugProbe>, DebugProbeError> {
        Err(ProbeCreationError::NotFound.into())
    }

    fn list_probes(&self) -> Vec<ProbeListItem> {
        Vec::new()
    }
}

/// A probe whose cable to the chip is not plugged in.
#[derive(Debug)]
pub(super) struct UnconnectedProbe;

impl DebugProbe for UnconnectedProbe {
    fn get_name(&self) -> &'static str {
        "unconnected"
    }

    fn speed_khz(&self) -> u32 {
        1000
    }

    fn set_speed(&mut self, speed_khz: u32) -> Result<u32, DebugProbeError> {
        Ok(speed_khz)
    }

    fn attach(&mut self) -> Result<(), DebugProbeError> {
        Err(DebugProbeError::TargetNotFound)
    }

    fn detach(&mut self) -> Result<(), probe_rs::Error> {
        Ok(())
    }

    fn target_reset(&mut self) -> Result<(), DebugProbeError> {
        Err(DebugProbeError::TargetNotFound)
    }

    fn target_reset_assert(&mut self) -> Result<(), DebugProbeError> {
        Err(DebugProbeError::TargetNotFound)
    }

    fn target_reset_deassert(&mut self) -> Result<(), DebugProbeError> {
        Err(DebugProbeError::TargetNotFound)
    }

    fn select_protocol(&mut self, _: WireProtocol) -> Result<(), DebugProbeError> {
        Ok(())
    }

    fn active_protocol(&self) -> Option<WireProtocol> {
        Some(WireProtocol::Swd)
    }

    fn has_arm_interface(&self) -> bool {
        true
    }

    fn into_probe(self: Box<Self>) -> Box<dyn DebugProbe> {
        self
    }
}
