//! Small ELF files for the tests: headers and segments, nothing else.

use object::elf::{
    ELFCLASS32, ELFDATA2LSB, ELFMAG, EM_ARM, ET_EXEC, EV_CURRENT, FileHeader32, Ident, PT_LOAD,
    ProgramHeader32,
};
use object::pod::bytes_of;
use object::{LittleEndian, U16, U32};

const LE: LittleEndian = LittleEndian;
const HEADER_LENGTH: usize = size_of::<FileHeader32<LittleEndian>>();
const PROGRAM_HEADER_LENGTH: usize = size_of::<ProgramHeader32<LittleEndian>>();

/// An ARM executable with one loadable segment for each (physical address, bytes).
pub(crate) fn elf(segments: &[(u32, &[u8])]) -> Vec<u8> {
    elf_of(EM_ARM, ET_EXEC, segments)
}

/// As [`elf`], for another `machine` or of another `kind` of ELF file.
pub(crate) fn elf_of(machine: u16, kind: u16, segments: &[(u32, &[u8])]) -> Vec<u8> {
    let header = FileHeader32 {
        e_ident: Ident {
            magic: ELFMAG,
            class: ELFCLASS32,
            data: ELFDATA2LSB,
            version: EV_CURRENT,
            os_abi: 0,
            abi_version: 0,
            padding: [0; 7],
        },
        e_type: U16::new(LE, kind),
        e_machine: U16::new(LE, machine),
        e_version: U32::new(LE, u32::from(EV_CURRENT)),
        e_entry: U32::new(LE, 0),
        e_phoff: word(HEADER_LENGTH),
        e_shoff: U32::new(LE, 0),
        e_flags: U32::new(LE, 0),
        e_ehsize: half(HEADER_LENGTH),
        e_phentsize: half(PROGRAM_HEADER_LENGTH),
        e_phnum: half(segments.len()),
        e_shentsize: U16::new(LE, 0),
        e_shnum: U16::new(LE, 0),
        e_shstrndx: U16::new(LE, 0),
    };
    let mut file = bytes_of(&header).to_vec();
    let mut offset = HEADER_LENGTH + segments.len() * PROGRAM_HEADER_LENGTH;
    for (address, bytes) in segments {
        file.extend_from_slice(bytes_of(&ProgramHeader32 {
            p_type: U32::new(LE, PT_LOAD),
            p_offset: word(offset),
            p_vaddr: U32::new(LE, *address),
            p_paddr: U32::new(LE, *address),
            p_filesz: word(bytes.len()),
            p_memsz: word(bytes.len().max(4)),
            p_flags: U32::new(LE, 0),
            p_align: U32::new(LE, 1),
        }));
        offset += bytes.len();
    }
    for (_, bytes) in segments {
        file.extend_from_slice(bytes);
    }
    file
}

fn word(length: usize) -> U32<LittleEndian> {
    U32::new(LE, u32::try_from(length).unwrap())
}

fn half(length: usize) -> U16<LittleEndian> {
    U16::new(LE, u16::try_from(length).unwrap())
}
