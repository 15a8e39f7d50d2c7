//! A rectangular plot's frame, grid, numbers and axis descriptions.
//!
//! Drawn here rather than by the drawing library's chart, which knows no letter widths in an SVG and so can neither make
//! a plot exactly square nor keep a description clear of the numbers.

use std::ops::Range;

use plotters::coord::types::RangedCoordf64;
use plotters::prelude::{Cartesian2d, DrawingArea, FontTransform, PathElement, SVGBackend};
use plotters::style::text_anchor::HPos;

use super::style::{GRID, INK, LABEL_SIZE, TICK_SIZE, line, text};
use super::ticks::Ticks;
use super::{Canvas, DrawingFailure};

/// A canvas on which elements are placed in the units of two axes.
pub(super) type Plane<'a> = DrawingArea<SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;

/// The pixels that a plot's frame encloses.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    pub(super) left: i32,
    pub(super) right: i32,
    pub(super) top: i32,
    pub(super) bottom: i32,
}

/// One axis of a plot.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub(super) range: Range<f64>,
    pub(super) ticks: Ticks,
    /// What the axis shows, with its unit.
    pub(super) description: String,
}

/// Pixels between the frame and the numbers beside it.
const NUMBER_GAP: i32 = 14;
/// Pixels that a digit takes at most, in the sans-serif letters of any viewer.
const DIGIT_WIDTH: i32 = 14;

/// The coordinates of a plot: the ends of `across` and `up` are the edges of `frame`.
pub(super) fn plane<'a>(canvas: &Canvas<'a>, frame: Frame, across: Range<f64>, up: Range<f64>) -> Plane<'a> {
    // Rows count downwards, the axis upwards.
    let pixels = (frame.left..frame.right, frame.bottom..frame.top);
    canvas.apply_coord_spec(Cartesian2d::new(across, up, pixels))
}

/// Draws everything of a plot that is not data, and returns the plane to draw the data on.
pub(super) fn draw_axes<'a>(
    canvas: &Canvas<'a>,
    frame: Frame,
    across: &Axis,
    up: &Axis,
) -> Result<Plane<'a>, DrawingFailure> {
    let Frame { left, right, top, bottom } = frame;
    let plane = plane(canvas, frame, across.range.clone(), up.range.clone());

    for tick in &across.ticks.positions {
        let column = plane.map_coordinate(&(*tick, up.range.start)).0;
        canvas.draw(&PathElement::new(vec![(column, top), (column, bottom)], line(GRID, 2)))?;
        canvas.draw(&PathElement::new(vec![(column, bottom), (column, bottom + 8)], line(INK, 2)))?;
        let below = (column, bottom + NUMBER_GAP + 14);
        canvas.draw_text(&across.ticks.label(*tick), &text(TICK_SIZE, HPos::Center), below)?;
    }
    let mut widest_number = 0;
    for tick in &up.ticks.positions {
        let row = plane.map_coordinate(&(across.range.start, *tick)).1;
        canvas.draw(&PathElement::new(vec![(left, row), (right, row)], line(GRID, 2)))?;
        canvas.draw(&PathElement::new(vec![(left - 8, row), (left, row)], line(INK, 2)))?;
        let number = up.ticks.label(*tick);
        canvas.draw_text(&number, &text(TICK_SIZE, HPos::Right), (left - NUMBER_GAP, row))?;
        widest_number = number.chars().fold(0, |width, _| width + DIGIT_WIDTH).max(widest_number);
    }
    // A path and not a rectangle, whose outline the backend draws one pixel wide whatever its style.
    let corners = vec![(left, top), (right, top), (right, bottom), (left, bottom), (left, top)];
    canvas.draw(&PathElement::new(corners, line(INK, 2)))?;

    let label = text(LABEL_SIZE, HPos::Center);
    let below_numbers = (left + (right - left) / 2, bottom + NUMBER_GAP + 56);
    canvas.draw_text(&across.description, &label, below_numbers)?;
    let beside_numbers = (left - NUMBER_GAP - widest_number - 22, top + (bottom - top) / 2);
    canvas.draw_text(&up.description, &label.transform(FontTransform::Rotate270), beside_numbers)?;
    Ok(plane)
}
