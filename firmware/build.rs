//! Links the image: memory layout, vector table and log strings. There is nothing to do for the host.
//!
//! An image is for one board: where none or several are named, nothing is built. There is no default, since the image for another
//! board's crystal may drive the processor faster than it is made for.

use std::env;
use std::path::PathBuf;

/// The features that name a board.
const BOARDS: &[&str] = &["feather-stm32f405", "olimex-stm32-h405", "emulated"];

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    println!("cargo:rerun-if-changed=../memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    // The measurement of speed has no board.
    let chosen = BOARDS.iter().filter(|board| is_on(board)).count();
    if chosen != 1 && !is_on("speed") {
        println!(
            "cargo::error=name the one board that the image is for: --features and one of {}",
            BOARDS.join(", ")
        );
        return;
    }
    // Where nobody asks for another level: without one, nothing but errors is in the image.
    println!("cargo:rerun-if-env-changed=DEFMT_LOG");
    println!("cargo:rustc-env=DEFMT_LOG={}", env::var("DEFMT_LOG").as_deref().unwrap_or("info"));
    let workspace = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default()).join("..");
    println!("cargo:rustc-link-search={}", workspace.display());
    // Sections need no page alignment: there is no loader.
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo:rustc-link-arg-bins={argument}");
    }
}

/// Whether this feature is on.
fn is_on(feature: &str) -> bool {
    env::var_os(format!("CARGO_FEATURE_{}", feature.to_uppercase().replace('-', "_"))).is_some()
}
