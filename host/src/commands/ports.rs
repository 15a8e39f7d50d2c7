//! `ftcal ports`: the serial ports of this machine.

use clap::Args;
use serialport::{SerialPortInfo, SerialPortType};

use super::device::{available_ports, is_plausible};
use super::{Failure, Streams};

/// The arguments of `ftcal ports`: none.
#[derive(Args, Clone, Debug)]
pub struct Arguments {}

/// Prints one port a line: path, and what is known of it.
///
/// # Errors
///
/// [`Failure`].
pub fn run(_: &Arguments, streams: &mut Streams) -> Result<(), Failure> {
    let ports = available_ports()?;
    if ports.is_empty() {
        writeln!(
            streams.words,
            "No serial port found. Plug the sensor in, or start a simulated one with `ftcal sim`."
        )?;
    } else if !ports.iter().any(is_plausible) {
        writeln!(streams.words, "None of these is a USB serial port, as a sensor would be.")?;
    }
    for port in &ports {
        writeln!(streams.data, "{}\t{}", port.port_name, description(port))?;
    }
    Ok(())
}

fn description(port: &SerialPortInfo) -> String {
    match &port.port_type {
        SerialPortType::UsbPort(usb) => {
            let name = usb.product.as_deref().or(usb.manufacturer.as_deref()).unwrap_or("unnamed");
            let number = usb
                .serial_number
                .as_deref()
                .map(|number| format!(", serial number {number}"))
                .unwrap_or_default();
            format!("USB {:04x}:{:04x}, {name}{number}", usb.vid, usb.pid)
        }
        SerialPortType::PciPort => "built in".to_owned(),
        SerialPortType::BluetoothPort => "Bluetooth".to_owned(),
        SerialPortType::Unknown => "unknown".to_owned(),
    }
}
