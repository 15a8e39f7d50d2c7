//! The firmware image: what of an ELF file is written to the chip, checked before any probe is touched.
//!
//! An image is a 32-bit little-endian ARM executable. What counts are its loadable segments (`PT_LOAD`) that have
//! bytes in the file, at their physical addresses: that is where initialised data lies in flash before
//! the start-up code copies it to RAM. Segments without bytes (`.bss`, the stack) are no part of it.
//!
//! Every byte must lie in the flash of the STM32F405RG: 1 MiB from `0x0800_0000` (datasheet, memory mapping).
//! The segments returned here are the very ones that are written: nothing parses the file a second time.

use std::io;
use std::ops::Range;
use std::path::{Path, PathBuf};

use object::elf::{EM_ARM, ET_EXEC, FileHeader32, PT_LOAD};
use object::read::elf::{FileHeader, ProgramHeader};
use object::{Endianness, FileKind};

/// The addresses of the chip's flash.
pub const CHIP_FLASH: Range<u64> = 0x0800_0000..0x0810_0000;

/// A firmware image all of whose bytes lie in the chip's flash.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FirmwareImage {
    segments: Vec<Segment>,
}

/// Bytes that belong together at one address.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Segment {
    /// Where the first byte goes.
    pub address: u64,
    /// What is written there; never empty.
    pub bytes: Vec<u8>,
}

/// Why a file is no firmware image for this chip.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file is missing or may not be read.
    #[error("{} could not be read", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// The file is no ELF file.
    #[error("the image is not an ELF file")]
    NotElf,
    /// An ELF file whose headers contradict themselves.
    #[error("the image is a damaged ELF file")]
    Damaged(#[from] object::Error),
    /// The file ends before the bytes of a segment do.
    #[error("the image is cut short: the bytes for address {address:#010x} are missing")]
    CutShort {
        /// Where the segment was to go.
        address: u64,
    },
    /// An ELF file, but for another processor.
    #[error("the image is not for this chip: it must be 32-bit, little-endian and for ARM")]
    OtherProcessor,
    /// An ELF file for ARM that is not linked yet: an object file or a library.
    #[error("the image is not an executable")]
    NotExecutable,
    /// No segment has bytes to load.
    #[error("the image holds nothing to write")]
    NothingToWrite,
    /// A segment reaches out of the chip's flash.
    #[error(
        "the image has a byte for address {address:#010x}, which is not in the chip's flash \
         ({:#010x} to {:#010x})", CHIP_FLASH.start, CHIP_FLASH.end - 1
    )]
    OutsideFlash {
        /// The first address of the segment that is not in the flash.
        address: u64,
    },
}

impl FirmwareImage {
    /// Reads and checks the ELF file at `path`.
    ///
    /// # Errors
    /// Every [`ImageError`].
    pub fn read(path: &Path) -> Result<Self, ImageError> {
        let elf =
            std::fs::read(path).map_err(|source| ImageError::Unreadable { path: path.to_owned(), source })?;
        Self::parse(&elf)
    }

    /// Checks an ELF file that was read already.
    ///
    /// # Errors
    /// Every [`ImageError`] but [`ImageError::Unreadable`].
    pub fn parse(elf: &[u8]) -> Result<Self, ImageError> {
        match FileKind::parse(elf) {
            Ok(FileKind::Elf32) => {}
            Ok(FileKind::Elf64) => return Err(ImageError::OtherProcessor),
            Ok(_) | Err(_) => return Err(ImageError::NotElf),
        }
        let header = FileHeader32::<Endianness>::parse(elf)?;
        let endian = header.endian()?;
        if endian != Endianness::Little || header.e_machine(endian) != EM_ARM {
            return Err(ImageError::OtherProcessor);
        }
        if header.e_type(endian) != ET_EXEC {
            return Err(ImageError::NotExecutable);
        }
        let mut segments = Vec::new();
        for program_header in header.program_headers(endian, elf)? {
            if program_header.p_type(endian) != PT_LOAD || program_header.p_filesz(endian) == 0 {
                continue;
            }
            let address = u64::from(program_header.p_paddr(endian));
            let bytes =
                program_header.data(endian, elf).map_err(|()| ImageError::CutShort { address })?.to_vec();
            check_in_flash(&(address..address + bytes.len() as u64))?;
            segments.push(Segment { address, bytes });
        }
        if segments.is_empty() { Err(ImageError::NothingToWrite) } else { Ok(Self { segments }) }
    }

    /// What is written, in the order of the file.
    pub fn segments(&self) -> &[Segment] {
        &self.segments
    }

    /// How many bytes are written.
    pub fn len_bytes(&self) -> usize {
        self.segments.iter().map(|segment| segment.bytes.len()).sum()
    }
}

/// Names the first address of a segment that the flash does not have.
fn check_in_flash(segment: &Range<u64>) -> Result<(), ImageError> {
    if !CHIP_FLASH.contains(&segment.start) {
        return Err(ImageError::OutsideFlash { address: segment.start });
    }
    if segment.end > CHIP_FLASH.end {
        return Err(ImageError::OutsideFlash { address: CHIP_FLASH.end });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use object::elf::{EM_ARM, EM_RISCV, ET_EXEC, ET_REL};

    use super::{CHIP_FLASH, FirmwareImage, ImageError, Segment};
    use crate::flash::test_elf::{elf, elf_of};

    const START: u32 = 0x0800_0000;
    const LAST: u32 = 0x080f_ffff;

    #[test]
    fn an_image_is_its_segments() {
        let image = FirmwareImage::parse(&elf(&[(START, &[1, 2, 3, 4]), (START + 0x200, &[5])])).unwrap();
        let expected = [
            Segment { address: u64::from(START), bytes: vec![1, 2, 3, 4] },
            Segment { address: u64::from(START) + 0x200, bytes: vec![5] },
        ];
        assert_eq!(image.segments(), expected);
        assert_eq!(image.len_bytes(), 5);
    }

    #[test]
    fn the_first_and_the_last_byte_of_the_flash_belong_to_it() {
        assert!(FirmwareImage::parse(&elf(&[(START, &[0]), (LAST, &[0])])).is_ok());
    }

    #[test]
    fn the_address_outside_the_flash_is_named() {
        let beyond = u64::from(LAST) + 1;
        let cases = [
            (START - 1, 4, u64::from(START) - 1),
            (LAST, 2, beyond),
            (LAST + 1, 1, beyond),
            (0x2000_0000, 4, 0x2000_0000),
            (u32::MAX, 4, u64::from(u32::MAX)),
        ];
        for (start, length, expected) in cases {
            let refused = FirmwareImage::parse(&elf(&[(START, &[0]), (start, &vec![0; length])]));
            let Err(error @ ImageError::OutsideFlash { address }) = refused else {
                panic!("{start:#x}: {refused:?}");
            };
            assert_eq!(address, expected);
            assert!(!CHIP_FLASH.contains(&address));
            assert!(error.to_string().contains(&format!("{expected:#010x}")), "{error}");
        }
    }

    #[test]
    fn segments_without_bytes_may_lie_anywhere_but_are_no_image() {
        let with_bss = FirmwareImage::parse(&elf(&[(START, &[1]), (0x2000_0000, &[])])).unwrap();
        assert_eq!(with_bss.segments().len(), 1);
        for nothing in [elf(&[]), elf(&[(0x2000_0000, &[])])] {
            assert!(matches!(FirmwareImage::parse(&nothing), Err(ImageError::NothingToWrite)));
        }
    }

    #[test]
    fn other_files_are_refused() {
        let parse = |bytes: &[u8]| FirmwareImage::parse(bytes);
        for no_elf in [&b""[..], b"\x7fELF", b"#!/bin/sh\n echo no firmware here, but long enough to look"] {
            assert!(matches!(parse(no_elf), Err(ImageError::NotElf)));
        }
        let segments = [(START, &[1, 2, 3, 4][..])];
        let risc_v = elf_of(EM_RISCV, ET_EXEC, &segments);
        assert!(matches!(parse(&risc_v), Err(ImageError::OtherProcessor)));
        let object_file = elf_of(EM_ARM, ET_REL, &segments);
        assert!(matches!(parse(&object_file), Err(ImageError::NotExecutable)));
    }

    #[test]
    fn no_image_that_is_cut_short_passes() {
        let whole = elf(&[(START, &[1, 2, 3, 4]), (START + 0x200, &[5, 6])]);
        assert!(FirmwareImage::parse(&whole).is_ok());
        for length in 0..whole.len() {
            assert!(FirmwareImage::parse(&whole[..length]).is_err(), "{length} bytes");
        }
        let refused = FirmwareImage::parse(&whole[..whole.len() - 1]);
        assert!(matches!(refused, Err(ImageError::CutShort { address: 0x0800_0200 })), "{refused:?}");
    }

    #[test]
    fn a_missing_file_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let missing = directory.path().join("missing.elf");
        let refused = FirmwareImage::read(&missing);
        assert!(matches!(refused, Err(ImageError::Unreadable { path, .. }) if path == missing));
    }
}
