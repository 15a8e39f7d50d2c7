//! Fuzz input as a line of bytes that a decoder takes further than its checksum.
//!
//! A fuzzer does not find checksums. So the input is cut into pieces, each by a byte that tells what it is: noise, which goes onto
//! the line as it is, or a payload, which gets the checksum and the stuffing that make it a frame.

use ftcal_shared::wire::frame::{END_OF_FRAME, encode};
use serde::ser::SerializeTuple;
use serde::{Serialize, Serializer};

/// The payload of a frame, byte by byte.
struct Payload<'a>(&'a [u8]);

impl Serialize for Payload<'_> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut bytes = serializer.serialize_tuple(self.0.len())?;
        for byte in self.0 {
            bytes.serialize_element(byte)?;
        }
        bytes.end()
    }
}

/// The pieces of an input, as they come over the line; each with what its first byte says beside.
pub fn pieces(input: &[u8]) -> impl Iterator<Item = (u8, Vec<u8>)> {
    let mut rest = input;
    std::iter::from_fn(move || {
        let (&kind, after) = rest.split_first()?;
        let (&length, after) = after.split_first()?;
        // Two bits more than a byte: the longest payload has 512 bytes.
        let length = (usize::from(length) | usize::from(kind & 3) << 8).min(after.len());
        let (piece, after) = after.split_at(length);
        rest = after;
        let bytes = if kind & 4 == 0 {
            piece.to_vec()
        } else {
            let mut framed = vec![END_OF_FRAME];
            // What is longer than a payload may be is no frame.
            framed.extend(encode(&Payload(piece)).unwrap_or_default());
            framed
        };
        Some((kind, bytes))
    })
}
