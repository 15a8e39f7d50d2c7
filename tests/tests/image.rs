//! What the images of the boards take of the chip, and that it is no more than they may. (The emulated one has a tunnel besides.)

use ftcal_tests::image::{LARGEST_FLASH, LARGEST_RAM, path, sizes};

#[test]
#[ignore = "needs the images: tests/run builds them"]
fn the_image_of_the_feather_fits_into_what_it_may_take() {
    fits("ftcal-feather-stm32f405.elf");
}

#[test]
#[ignore = "needs the images: tests/run builds them"]
fn the_image_of_the_olimex_board_fits_into_what_it_may_take() {
    fits("ftcal-olimex-stm32-h405.elf");
}

fn fits(name: &str) {
    let sizes = sizes(&path(name));
    // For tests/speed: bytes, of RAM without the stack.
    println!("{name}:\nflash {}\nram {}", sizes.flash, sizes.ram);
    assert!(sizes.flash > 0 && sizes.ram > 0, "{name}: {sizes:?}");
    assert!(sizes.flash <= LARGEST_FLASH, "{name}: {sizes:?}");
    assert!(sizes.ram < LARGEST_RAM, "{name}: {sizes:?}");
}
