//! Whatever comes over the line, the host reads no number that is none: wrenches are finite, of the calibration that is known, and
//! as many as there are axes; and what is missing is counted without panic.
#![no_main]
// Parts of the host that have no use here.
#![allow(dead_code, unreachable_pub)]

#[path = "../../host/src/link/continuity.rs"]
mod continuity;
#[path = "../../host/src/link/frame.rs"]
mod frame;
mod framed;

use std::time::Duration;

use ftcal_shared::units::Dof;
use ftcal_shared::wire::ToHost;
use ftcal_shared::wire::frame::{Decoder, encode};
use libfuzzer_sys::fuzz_target;

use continuity::Continuity;
use frame::{Frame, KnownCalibration, Measured, WrenchSample};

const KNOWN: KnownCalibration = KnownCalibration { identity: 7, dof: Dof::PlanarForceTorque };

fn check(sample: &WrenchSample) {
    if let Measured::Valid(wrench) = sample.at_any_age() {
        assert_eq!((wrench.calibration(), wrench.components().len()), (KNOWN.identity, KNOWN.dof.count()));
        assert!(wrench.components().iter().all(|component| component.is_finite()));
    }
    // Whatever its age, to ask for it is safe.
    let _ = sample.within(Duration::from_millis(10), Duration::from_secs(60));
}

fuzz_target!(|input: &[u8]| {
    let mut decoder = Decoder::new();
    let mut continuity = Continuity::default();
    for (_, bytes) in framed::pieces(input) {
        for byte in bytes {
            let Some(Ok(message)) = decoder.push::<ToHost>(byte) else { continue };
            // What was read off the line could have been put there.
            assert!(encode(&message).is_ok());
            let frames = match message {
                ToHost::Codes(frame) => vec![Frame::Codes(frame)],
                ToHost::Wrench(frame) => {
                    let samples =
                        WrenchSample::read(&frame, Some(KNOWN), Duration::ZERO, Duration::from_secs(1));
                    samples.into_iter().flatten().inspect(check).map(Frame::Wrench).collect()
                }
                ToHost::Hello(_) | ToHost::Response(..) => continue,
            };
            for frame in frames {
                let (index, stride) = frame.place();
                let _ = continuity.missing_before(index, stride);
            }
        }
    }
});
