//! What the sensor keeps across a reset: stored, brought back, named. All of it may be asked for twice.

use std::time::Duration;

use ftcal_shared::wire::{
    CalibrationUpload, Identity, KeptCalibration, KeptCalibrations, MemoryRequest, Rejection, Request,
    Response, SensorName, Status,
};

use super::{ANSWER, Client};
use crate::link::error::{ClientError, LinkError};
use crate::link::transport::Transport;

/// How long the sensor's memory may take: a store may have to erase two sectors, of two seconds each.
pub(super) const STORING: Duration = Duration::from_secs(10);

impl<Line: Transport> Client<Line> {
    /// Has the calibration in use kept across resets, and makes sure that it is. The one kept so far becomes the previous one.
    ///
    /// # Errors
    ///
    /// [`LinkError::ReadBackDiffers`]; [`ClientError`].
    pub fn store_calibration(&mut self) -> Result<KeptCalibrations, ClientError> {
        self.request_memory(MemoryRequest::StoreCalibration)?;
        let Status { calibration, kept, .. } = self.status()?;
        match calibration {
            Some(in_use) if kept.current != KeptCalibration::Calibration(in_use) => {
                Err(LinkError::ReadBackDiffers { uploaded: in_use }.into())
            }
            _ => Ok(kept),
        }
    }

    /// Has the sensor use and keep the calibration before the one that it keeps.
    ///
    /// # Errors
    ///
    /// [`Rejection::NoSuchCalibration`] where there is none; [`ClientError`].
    pub fn roll_back(&mut self) -> Result<CalibrationUpload, ClientError> {
        let nothing = ClientError::Rejected(Rejection::NoSuchCalibration);
        let Some(to) = self.status()?.kept.previous else { return Err(nothing) };
        let in_use =
            self.request_calibration_within(Request::Memory(MemoryRequest::RollBack { to }), STORING)?;
        in_use.filter(|upload| upload.identity == to).ok_or(nothing)
    }

    /// Has data rate and gain kept across resets as they are set now.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn store_settings(&mut self) -> Result<(), ClientError> {
        self.request_memory(MemoryRequest::StoreSettings)
    }

    /// Gives the sensor a name, for good.
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn write_name(&mut self, name: SensorName) -> Result<(), ClientError> {
        self.request_memory(MemoryRequest::WriteName(name))
    }

    /// What are you called, and what have you been through?
    ///
    /// # Errors
    ///
    /// [`ClientError`].
    pub fn identity(&mut self) -> Result<Identity, ClientError> {
        match self.conversation.request(Request::ReadIdentity, ANSWER)? {
            Response::Identity(identity) => Ok(identity),
            _ => Err(LinkError::UnexpectedResponse.into()),
        }
    }

    fn request_memory(&mut self, request: MemoryRequest) -> Result<(), ClientError> {
        self.request_done_within(Request::Memory(request), STORING)
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::{DataRate, Dof, Gain};
    use ftcal_shared::wire::{
        CalibrationUpload, GageList, KeptCalibration, KeptCalibrations, Rejection, SensorName, StreamKind,
    };

    use super::Client;
    use crate::link::error::ClientError;
    use crate::simulator::board::SimulatedBoard;
    use crate::simulator::flash::SimulatedFlash;
    use crate::simulator::scenario::{Scenario, ScenarioKind};

    /// A sensor that was just switched on, with what this flash keeps.
    fn switched_on(kind: ScenarioKind, flash: &SimulatedFlash) -> Client<SimulatedBoard> {
        let sensor = Scenario::new(kind, 7).expect("sizes fit").sensor;
        let board = SimulatedBoard::with_flash(sensor, 7, flash.clone()).expect("sizes fit");
        let mut client = Client::connect(board).expect("answers");
        client.wait_for_converter().expect("the converter starts");
        client
    }

    fn calibration(first_element: f32) -> CalibrationUpload {
        let bias_counts = GageList::from_slice(&[0.0; 8]).expect("room");
        let matrix = std::iter::once(first_element).chain([0.5; 47]).collect();
        let mut upload = CalibrationUpload {
            dof: Dof::SpatialForceTorque,
            gain: Gain::X64,
            bias_counts,
            matrix,
            identity: 0,
        };
        upload.identity = upload.identity_of_numbers();
        upload
    }

    fn rejected<Value>(outcome: Result<Value, ClientError>) -> Rejection {
        match outcome {
            Err(ClientError::Rejected(rejection)) => rejection,
            Err(error) => panic!("{error}"),
            Ok(_) => panic!("served"),
        }
    }

    #[test]
    fn what_is_stored_survives_a_reset_and_what_is_not_does_not() {
        let flash = SimulatedFlash::default();
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        assert_eq!(client.status().expect("answers").kept.current, KeptCalibration::Nothing);
        assert_eq!(rejected(client.store_calibration()), Rejection::Uncalibrated);
        client.configure_adc(DataRate::Hz500, Gain::X1).expect("the converter starts");
        client.upload_calibration(&calibration(1.0)).expect("taken");
        client.store_calibration().expect("kept");
        client.upload_calibration(&calibration(2.0)).expect("taken");

        // The gain is that of the calibration, whatever the converter had meanwhile; the rate that of a new sensor.
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        let status = client.status().expect("answers");
        assert_eq!((status.data_rate, status.gain), (DataRate::default(), Gain::X64));
        assert_eq!(client.read_calibration().expect("answers"), Some(calibration(1.0)));
        client.configure_adc(DataRate::Hz250, Gain::X32).expect("the converter starts");
        client.store_settings().expect("kept");
        client.write_name(SensorName::try_from("left").expect("short")).expect("kept");

        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        let status = client.status().expect("answers");
        assert_eq!((status.data_rate, status.gain), (DataRate::Hz250, Gain::X32));
        let identity = client.identity().expect("answers");
        assert_eq!((identity.name.as_str(), identity.boots, identity.stores), ("left", 3, 1));
    }

    #[test]
    fn a_rollback_can_be_undone_by_another() {
        let flash = SimulatedFlash::default();
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        assert_eq!(rejected(client.roll_back()), Rejection::NoSuchCalibration);
        for number in [1.0, 2.0] {
            client.upload_calibration(&calibration(number)).expect("taken");
            client.store_calibration().expect("kept");
        }
        for number in [1.0, 2.0, 1.0] {
            assert_eq!(client.roll_back().expect("there is one"), calibration(number));
            assert_eq!(client.read_calibration().expect("answers"), Some(calibration(number)));
        }
        let kept = KeptCalibrations {
            current: KeptCalibration::Calibration(calibration(1.0).identity),
            previous: Some(calibration(2.0).identity),
        };
        assert_eq!(client.status().expect("answers").kept, kept);
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        assert_eq!(client.status().expect("answers").kept, kept);
        assert_eq!(client.read_calibration().expect("answers"), Some(calibration(1.0)));
    }

    #[test]
    fn nothing_is_stored_while_samples_are_streamed_or_summed_up() {
        let flash = SimulatedFlash::default();
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        client.upload_calibration(&calibration(1.0)).expect("taken");
        client.stream(StreamKind::Codes).expect("answers");
        assert_eq!(rejected(client.store_calibration()), Rejection::Measuring);
        client.stream(StreamKind::Off).expect("answers");
        client.start_trial(3).expect("answers");
        assert_eq!(rejected(client.store_settings()), Rejection::Measuring);
        client.identity().expect("told at any time");
        client.stop_trial().expect("answers");
        client.store_calibration().expect("kept");
    }

    #[test]
    fn a_calibration_of_another_sensor_is_not_used_and_that_is_said() {
        let flash = SimulatedFlash::default();
        let mut client = switched_on(ScenarioKind::Wrist, &flash);
        client.upload_calibration(&calibration(1.0)).expect("taken");
        client.store_calibration().expect("kept");
        let mut client = switched_on(ScenarioKind::Fingertip, &flash);
        assert_eq!(client.status().expect("answers").kept.current, KeptCalibration::Unusable);
        assert_eq!(client.read_calibration().expect("answers"), None);
    }
}
