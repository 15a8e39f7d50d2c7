//! What the images of the boards take of the chip, and that it is no more than they may. (The emulated one has a tunnel besides.)

use ftcal_tests::image::{LARGEST_FLASH, LARGEST_RAM, path, sizes};

#[test]
#[ignore = "needs the images: tests/run builds them"]
fn every_board_s_image_fits_into_what_it_may_take() {
    for name in ["ftcal-feather-stm32f405.elf", "ftcal-olimex-stm32-h405.elf"] {
        let sizes = sizes(&path(name));
        println!("{name}: {} bytes of flash, {} of RAM without the stack", sizes.flash, sizes.ram);
        assert!(sizes.flash > 0 && sizes.ram > 0, "{name}: {sizes:?}");
        assert!(sizes.flash <= LARGEST_FLASH, "{name}: {sizes:?}");
        assert!(sizes.ram < LARGEST_RAM, "{name}: {sizes:?}");
    }
}
