//! Angular error of the force at known loads: least squares solid, shape from motion dotted (paper figure 9).
//!
//! The angular error is the angle between the force that a calibration gives and the force that truly acts. The loads
//! stand in the order in which they were hung, one marker a load and method; the lines only lead the eye. The
//! lower axis starts at zero, so that heights compare as the errors do.
//!
//! Failure: no loads, or an error that cannot be drawn.

use std::path::Path;

use plotters::element::DottedPathElement;
use plotters::prelude::{Circle, Color, PathElement};
use plotters::style::text_anchor::HPos;

use super::axes::{Axis, Frame, draw_axes};
use super::style::{
    BLUE, DOT_OF_LINE, MARKER, Mark, TITLE_SIZE, VERMILLION, legend_entry, line, square, text,
};
use super::ticks::{Ticks, padded_range};
use super::{Canvas, DrawingFailure, LARGEST_VALUE, PlotError, check_points, render_svg, write_svg};

/// The angular error of either calibration at one known load.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLoadError {
    /// Of the shape-from-motion calibration.
    pub shape_from_motion_milliradian: f64,
    /// Of the least-squares calibration (eq. 3).
    pub least_squares_milliradian: f64,
}

/// Width and height of the figure in pixels.
const SIZE: (u32, u32) = (1200, 760);
/// The frame of the plot.
const FRAME: Frame = Frame { left: 140, right: 1160, top: 125, bottom: 665 };

/// Writes the figure to `path`.
///
/// # Errors
/// As [`render`], and [`PlotError::Write`].
pub fn draw(loads: &[KnownLoadError], path: &Path) -> Result<(), PlotError> {
    write_svg(&render(loads)?, path)
}

/// The figure as an SVG document.
///
/// # Errors
/// [`PlotError::Empty`], [`PlotError::NotDrawable`].
pub fn render(loads: &[KnownLoadError]) -> Result<String, PlotError> {
    let errors = |load: &KnownLoadError| [load.shape_from_motion_milliradian, load.least_squares_milliradian];
    check_points(loads, LARGEST_VALUE, errors)?;
    let milliradian_range = 0.0..padded_range(loads.iter().flat_map(errors).chain([0.0])).end;
    let last_load = loads.len() as f64;
    let across = Axis {
        range: 0.5..last_load + 0.5,
        ticks: Ticks::counting(loads.len(), 12),
        description: "known load".to_owned(),
    };
    let up = Axis {
        ticks: Ticks::over(&milliradian_range, 8),
        range: milliradian_range,
        description: "angular error (mrad)".to_owned(),
    };
    render_svg(SIZE, |canvas| {
        canvas.draw_text("Angular error at known loads", &text(TITLE_SIZE, HPos::Center), (650, 34))?;
        legend_entry(canvas, (270, 84), &Mark::LineWithSquare(VERMILLION), "least squares")?;
        legend_entry(canvas, (690, 84), &Mark::DotsWithDot(BLUE), "shape from motion")?;
        draw_curves(canvas, loads, &across, &up)
    })
}

fn draw_curves(
    canvas: &Canvas<'_>,
    loads: &[KnownLoadError],
    across: &Axis,
    up: &Axis,
) -> Result<(), DrawingFailure> {
    let plane = draw_axes(canvas, FRAME, across, up)?;
    let pixels = |error: fn(&KnownLoadError) -> f64| -> Vec<(i32, i32)> {
        let numbered = loads.iter().enumerate();
        numbered.map(|(index, load)| plane.map_coordinate(&(index as f64 + 1.0, error(load)))).collect()
    };

    let least_squares = pixels(|load| load.least_squares_milliradian);
    canvas.draw(&PathElement::new(least_squares.clone(), line(VERMILLION, 3)))?;
    for pixel in least_squares {
        canvas.draw(&square(pixel, VERMILLION))?;
    }

    let shape_from_motion = pixels(|load| load.shape_from_motion_milliradian);
    let dot = |pixel| Circle::new(pixel, DOT_OF_LINE, BLUE.filled());
    canvas.draw(&DottedPathElement::new(shape_from_motion.clone(), 0, 10, dot))?;
    for pixel in shape_from_motion {
        canvas.draw(&Circle::new(pixel, MARKER, BLUE.filled()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{KnownLoadError, draw, render};
    use crate::plots::PlotError;

    fn load(shape_from_motion_milliradian: f64, least_squares_milliradian: f64) -> KnownLoadError {
        KnownLoadError { shape_from_motion_milliradian, least_squares_milliradian }
    }

    #[test]
    fn every_load_has_a_marker_of_either_kind() {
        let square_count = |count: usize| {
            let svg = render(&vec![load(2.5, 4.6); count]).unwrap();
            svg.lines().filter(|line| line.starts_with("<rect") && line.contains("#D55E00")).count()
        };
        assert_eq!(square_count(10) - square_count(1), 9);
        let dot_count = |count: usize| {
            let svg = render(&vec![load(2.5, 4.6); count]).unwrap();
            svg.lines().filter(|line| line.starts_with("<circle") && line.contains("r=\"8\"")).count()
        };
        assert_eq!(dot_count(10) - dot_count(1), 9);
    }

    #[test]
    fn one_load_and_no_error_at_all_can_be_drawn() {
        for loads in [vec![load(0.0, 0.0)], vec![load(0.0, 0.0); 2], vec![load(1.0, 2.0)]] {
            let svg = render(&loads).unwrap();
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
        }
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        assert!(matches!(render(&[]), Err(PlotError::Empty)));
        let broken = [load(1.0, 2.0), load(f64::NAN, 2.0)];
        assert!(matches!(render(&broken), Err(PlotError::NotDrawable { index: 1, .. })));
    }

    #[test]
    fn a_refused_figure_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("angular_error.svg");
        assert!(draw(&[], &path).is_err());
        assert!(!path.exists());
        draw(&[load(1.0, 2.0)], &path).unwrap();
        assert!(path.exists());
    }
}
