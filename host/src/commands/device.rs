//! Which sensor a command talks to.

use anyhow::{Context, anyhow};
use clap::Args;
use serialport::{SerialPortInfo, SerialPortType};

use super::Failure;
use crate::link::client::Client;
use crate::link::error::ClientError;
use crate::link::remedy::{of_client, of_open};
use crate::link::serial::{OpenError, SerialTransport};
use crate::remedy::Explained;

/// The port of the sensor.
#[derive(Args, Clone, Debug)]
pub struct DeviceArgs {
    /// Serial port of the sensor; not needed where there is exactly one USB serial port
    #[arg(long, value_name = "PATH")]
    port: Option<String>,
    /// Talk to the sensor at this baud rate, up to 2000000; it is 921600 otherwise
    #[arg(long, value_name = "RATE")]
    baud: Option<u32>,
}

impl DeviceArgs {
    /// Opens the port and greets the sensor.
    ///
    /// # Errors
    ///
    /// [`Failure::Input`] where there is no choice of port, or no sensor behind it.
    pub fn connect(&self) -> Result<Client<SerialTransport>, Failure> {
        let path = match &self.port {
            Some(path) => path.clone(),
            None => the_only(&available_ports()?)?,
        };
        let mut client = Client::connect(SerialTransport::open(&path)?)?;
        if let Some(baud) = self.baud {
            client.change_rate(baud)?;
        }
        Ok(client)
    }
}

/// The serial ports of this machine, by name.
///
/// # Errors
///
/// [`Failure::Input`] where the system does not tell.
pub fn available_ports() -> Result<Vec<SerialPortInfo>, Failure> {
    let mut ports = serialport::available_ports().context("the serial ports cannot be listed")?;
    ports.sort_by(|one, other| one.port_name.cmp(&other.port_name));
    Ok(ports)
}

/// Whether a sensor may be behind this port: its board has a USB serial converter. (macOS lists each port twice; `tty.…`
/// waits for a modem.)
pub fn is_plausible(port: &SerialPortInfo) -> bool {
    matches!(port.port_type, SerialPortType::UsbPort(_)) && !port.port_name.starts_with("/dev/tty.")
}

fn the_only(ports: &[SerialPortInfo]) -> Result<String, Failure> {
    let plausible: Vec<&str> =
        ports.iter().filter(|port| is_plausible(port)).map(|port| port.port_name.as_str()).collect();
    match plausible.as_slice() {
        [only] => Ok((*only).to_owned()),
        [] => Err(anyhow!(
            "no USB serial port found\n\
             Plug the sensor in, name its port with --port, or start a simulated one with `ftcal sim`."
        )
        .into()),
        several => Err(anyhow!(
            "several USB serial ports found: {}\nName the sensor's port with --port.",
            several.join(", ")
        )
        .into()),
    }
}

/// A sensor that cannot be reached is input that cannot be read; what a sensor says no to is refused.
impl From<ClientError> for Failure {
    fn from(error: ClientError) -> Self {
        let explained = of_client(&error);
        match error {
            ClientError::Link(_) => unreachable_sensor(&explained),
            ClientError::Rejected(_)
            | ClientError::Refused(_)
            | ClientError::Converter(_)
            | ClientError::ConverterNotStarting { .. }
            | ClientError::Restarted(_)
            | ClientError::StreamAbandoned
            | ClientError::NoSamples { .. } => Self::Refused(explained),
        }
    }
}

impl From<OpenError> for Failure {
    fn from(error: OpenError) -> Self {
        unreachable_sensor(&of_open(&error))
    }
}

fn unreachable_sensor(explained: &Explained) -> Failure {
    anyhow!("{}\n{}", explained.detail, explained.remedy).into()
}

#[cfg(test)]
mod tests {
    use serialport::{SerialPortInfo, SerialPortType, UsbPortInfo};

    use super::the_only;

    fn port(name: &str, usb: bool) -> SerialPortInfo {
        let port_type = if usb {
            SerialPortType::UsbPort(UsbPortInfo {
                vid: 1,
                pid: 2,
                serial_number: None,
                manufacturer: None,
                product: None,
                interface: None,
            })
        } else {
            SerialPortType::Unknown
        };
        SerialPortInfo { port_name: name.to_owned(), port_type }
    }

    #[test]
    fn a_port_is_chosen_only_where_there_is_no_choice() {
        assert!(the_only(&[]).is_err());
        assert!(the_only(&[port("/dev/ttyS0", false)]).is_err());
        let one = [port("/dev/ttyS0", false), port("/dev/ttyUSB3", true)];
        assert_eq!(the_only(&one).expect("one USB port"), "/dev/ttyUSB3");
        assert!(the_only(&[port("/dev/ttyUSB0", true), port("/dev/ttyUSB1", true)]).is_err());
        let twice = [port("/dev/cu.usbserial-1", true), port("/dev/tty.usbserial-1", true)];
        assert_eq!(the_only(&twice).expect("one USB port"), "/dev/cu.usbserial-1");
    }
}
