//! What an image takes of the chip.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use ftcal::flash::image::CHIP_FLASH;
use object::elf::SHF_ALLOC;
use object::read::elf::ElfFile32;
use object::{Object, ObjectSection, SectionFlags};

/// Addresses of the STM32F405's RAM.
const RAM: Range<u64> = 0x2000_0000..0x2002_0000;

/// What instructions and constants may take, bytes.
pub const LARGEST_FLASH: u64 = 160 * 1024;

/// What variables and the stack in use may take, bytes.
pub const LARGEST_RAM: u64 = 64 * 1024;

/// Bytes of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Instructions and constants; not what variables begin with.
    pub flash: u64,
    /// Variables, without the stack.
    pub ram: u64,
}

/// The image of this name, as `tests/run` leaves it.
pub fn path(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../target/images").join(name)
}

/// What the sections of an image take.
///
/// # Panics
///
/// Where there is no such image, or it is none.
pub fn sizes(image: &Path) -> Sizes {
    let bytes = fs::read(image).expect("tests/run builds it");
    let elf: ElfFile32 = ElfFile32::parse(&*bytes).expect("an image");
    let takes_memory =
        |flags| matches!(flags, SectionFlags::Elf { sh_flags } if sh_flags & u64::from(SHF_ALLOC) != 0);
    let within = |range: Range<u64>| {
        let sections = elf.sections().filter(|section| takes_memory(section.flags()));
        sections.filter(|section| range.contains(&section.address())).map(|section| section.size()).sum()
    };
    Sizes { flash: within(CHIP_FLASH), ram: within(RAM) }
}
