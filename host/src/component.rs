//! Symbols and units of the components of a wrench.

use ftcal_shared::units::Axis;

/// The usual symbol of a component.
pub const fn symbol(axis: Axis) -> &'static str {
    match axis {
        Axis::ForceX => "fx",
        Axis::ForceY => "fy",
        Axis::ForceZ => "fz",
        Axis::TorqueX => "tx",
        Axis::TorqueY => "ty",
        Axis::TorqueZ => "tz",
    }
}

/// Its unit.
pub const fn unit(axis: Axis) -> &'static str {
    if is_force(axis) { "N" } else { "N m" }
}

/// Whether it is a force; a torque otherwise.
pub const fn is_force(axis: Axis) -> bool {
    matches!(axis, Axis::ForceX | Axis::ForceY | Axis::ForceZ)
}
