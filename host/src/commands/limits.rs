//! `ftcal limits`: what load is too much, and which loads the user wants to hear of.

use std::io::{self, Write};
use std::str::FromStr;

use anyhow::anyhow;
use clap::Args;
use ftcal_shared::units::{Axis, Dof};
use ftcal_shared::wire::{LoadLimits, LoadThreshold};

use super::device::DeviceArgs;
use super::{Failure, Streams};
use crate::component::{symbol, unit};

/// The arguments of `ftcal limits`.
#[derive(Args, Clone, Debug)]
pub struct Arguments {
    #[command(flatten)]
    device: DeviceArgs,
    /// Largest magnitude of a component that does no harm, newton or newton metre, as in fz=200; fz=none for none
    #[arg(long = "largest", value_name = "AXIS=LIMIT")]
    largest: Vec<Setting>,
    /// Largest root of the summed squares of all components, each over its own limit; 1 is the ellipsoid through them
    #[arg(long, value_name = "LIMIT", value_parser = level)]
    combined: Option<f32>,
    /// Tell when a component is beyond a level, until it is less by the hysteresis, as in fz=50:2; fz=none for none
    #[arg(long = "threshold", value_name = "AXIS=LEVEL[:HYSTERESIS]")]
    thresholds: Vec<Setting>,
    /// Have the sensor keep them across resets, with all its settings
    #[arg(long)]
    store: bool,
}

/// What a component is set to.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Setting {
    axis: Axis,
    level: f32,
    hysteresis: f32,
}

impl FromStr for Setting {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, value) = text.split_once('=').ok_or("expected AXIS=VALUE, as in fz=200")?;
        let axes = Dof::SpatialForceTorque.axes().iter();
        let axis =
            axes.copied().find(|&axis| symbol(axis) == name).ok_or("expected fx, fy, fz, tx, ty or tz")?;
        let (value, below) = value.split_once(':').unwrap_or((value, "0"));
        let hysteresis = below.parse().map_err(|_| "expected a number after the colon")?;
        Ok(Self { axis, level: level(value)?, hysteresis })
    }
}

fn level(text: &str) -> Result<f32, String> {
    match text.parse::<f32>() {
        _ if text == "none" => Ok(f32::INFINITY),
        Ok(level) if level > 0.0 => Ok(level),
        _ => Err("expected a number above 0, or none".to_owned()),
    }
}

/// Sets what is asked for, if anything, and prints all limits.
///
/// # Errors
///
/// [`Failure`].
pub fn run(arguments: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let mut client = arguments.device.connect()?;
    // Limits are by component, which only a calibration gives a meaning to.
    let dof = client.read_calibration()?.map(|calibration| calibration.dof).ok_or_else(|| {
        anyhow!("the sensor has no calibration, so it has no components\nUpload one with `ftcal upload`.")
    })?;
    let before = client.limits()?;
    let wanted = arguments.applied_to(before, dof)?;
    let limits = if wanted == before { before } else { client.set_limits(wanted)? };
    if arguments.store {
        client.store_settings()?;
    }
    Ok(write_limits(&limits, dof, streams.data)?)
}

impl Arguments {
    /// These limits with what is asked for.
    fn applied_to(&self, mut limits: LoadLimits, dof: Dof) -> Result<LoadLimits, Failure> {
        for setting in &self.largest {
            if let Some(largest) = limits.largest.get_mut(position(dof, setting.axis)?) {
                *largest = setting.level;
            }
        }
        for setting in &self.thresholds {
            if let Some(threshold) = limits.thresholds.get_mut(position(dof, setting.axis)?) {
                *threshold = LoadThreshold { level: setting.level, hysteresis: setting.hysteresis };
            }
        }
        limits.combined = self.combined.unwrap_or(limits.combined);
        Ok(limits)
    }
}

fn position(dof: Dof, axis: Axis) -> Result<usize, Failure> {
    let position = dof.axes().iter().position(|&of| of == axis);
    Ok(position.ok_or_else(|| anyhow!("this sensor does not measure {}", symbol(axis)))?)
}

fn write_limits(limits: &LoadLimits, dof: Dof, out: &mut dyn Write) -> io::Result<()> {
    let number = |level: f32| if level.is_finite() { level.to_string() } else { "none".to_owned() };
    for ((&axis, &largest), threshold) in dof.axes().iter().zip(&limits.largest).zip(&limits.thresholds) {
        writeln!(
            out,
            "{} largest {}, threshold {} less {} ({})",
            symbol(axis),
            number(largest),
            number(threshold.level),
            threshold.hysteresis,
            unit(axis)
        )?;
    }
    writeln!(out, "combined {}", number(limits.combined))
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Axis;

    use super::Setting;

    #[test]
    fn settings_name_an_axis_a_level_and_a_hysteresis() {
        let setting = |axis, level, hysteresis| Ok(Setting { axis, level, hysteresis });
        assert_eq!("fz=200".parse(), setting(Axis::ForceZ, 200.0, 0.0));
        assert_eq!("tx=0.5:0.1".parse(), setting(Axis::TorqueX, 0.5, 0.1));
        assert_eq!("fx=none".parse(), setting(Axis::ForceX, f32::INFINITY, 0.0));
        for wrong in ["fz", "fz=", "fw=3", "fz=-1", "fz=0", "fz=nan", "fz=3:x"] {
            assert!(wrong.parse::<Setting>().is_err(), "{wrong}");
        }
    }
}
