//! The 16-bit checksum of the converter's frames, in both directions (datasheet section 8.3.12).
//!
//! Most significant bit first, no reflection, no final inversion, and a seed of `FFFFh`; the `CRC_TYPE` bit chooses
//! between two polynomials. Worked out bit by bit: slow, and plain enough to be compared with the datasheet by eye.

/// The two polynomials that the converter knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Polynomial {
    /// x¹⁶ + x¹² + x⁵ + 1, the default.
    Ccitt,
    /// x¹⁶ + x¹⁵ + x² + 1.
    Ansi,
}

impl Polynomial {
    /// The coefficients below x¹⁶.
    const fn coefficients(self) -> u16 {
        match self {
            Self::Ccitt => 0x1021,
            Self::Ansi => 0x8005,
        }
    }

    /// The checksum of these bytes, in the order in which they cross the bus.
    pub(super) fn checksum(self, bytes: &[u8]) -> u16 {
        bytes.iter().fold(0xFFFF, |remainder, &byte| {
            (0..8).fold(remainder ^ (u16::from(byte) << 8), |remainder, _| {
                let shifted = remainder << 1;
                if remainder & 0x8000 == 0 { shifted } else { shifted ^ self.coefficients() }
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::Polynomial;

    #[test]
    fn the_catalogued_check_values_come_out() {
        // The "check" of the public catalogue of CRC algorithms: CRC-16/IBM-3740 and CRC-16/CMS.
        assert_eq!(Polynomial::Ccitt.checksum(b"123456789"), 0x29B1);
        assert_eq!(Polynomial::Ansi.checksum(b"123456789"), 0xAEE7);
    }

    #[test]
    fn a_message_followed_by_its_checksum_leaves_nothing() {
        let message = [0x61, 0x00, 0x00, 0x15, 0x10, 0x00];
        for polynomial in [Polynomial::Ccitt, Polynomial::Ansi] {
            let mut whole = message.to_vec();
            whole.extend(polynomial.checksum(&message).to_be_bytes());
            assert_eq!(polynomial.checksum(&whole), 0);
        }
    }

    #[test]
    fn every_single_bit_error_changes_it() {
        let message = [0xA0, 0x80, 0x00];
        for polynomial in [Polynomial::Ccitt, Polynomial::Ansi] {
            for bit in 0..24 {
                let mut broken = message;
                broken[bit / 8] ^= 1 << (bit % 8);
                assert_ne!(polynomial.checksum(&broken), polynomial.checksum(&message));
            }
        }
    }
}
