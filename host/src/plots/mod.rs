//! The paper's figures as SVG: what was recovered, and how it compares with least squares.
//!
//! | module | figure of the paper | shows |
//! |---|---|---|
//! | [`polar`] | 5 | recovered motion, magnitude over direction |
//! | [`sphere`] | 6 | recovered motion of a spatial trial |
//! | [`magnitude`] | 8 | force magnitude as the orientation changes, both methods |
//! | [`angular_error`] | 9 | angular error at known loads, both methods |
//!
//! Every figure has two functions: `render` returns the SVG document, `draw` writes it to a file. Nothing is
//! written when the figure cannot be drawn: no points, or a value that is not finite, is an error and
//! never a picture with a hole in it.
//!
//! The colours are told apart without colour vision (Okabe and Ito), and colour never carries a meaning alone: the
//! two methods differ in line and marker, front and back in filled and open.

pub mod angular_error;
pub mod magnitude;
pub mod polar;
pub mod sphere;

mod axes;
mod style;
mod ticks;

use std::io;
use std::path::{Path, PathBuf};

use plotters::coord::Shift;
use plotters::prelude::{DrawingArea, DrawingAreaErrorKind, IntoDrawingArea, SVGBackend, WHITE};

/// The largest newton or milliradian that a figure accepts: its labels still fit beside the plot.
const LARGEST_VALUE: f64 = 1e6;
/// The largest number of unit loads that a figure accepts. A recovered load is about one unit, whatever hung there.
const LARGEST_UNIT_LOADS: f64 = 1e3;

/// Why a figure was not drawn.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// There is nothing to show.
    #[error("a figure needs at least one point")]
    Empty,
    /// A coordinate is not finite, or larger than any axis can show.
    #[error("point {index} has the coordinate {value}, which cannot be drawn")]
    NotDrawable {
        /// Position of the point in the slice.
        index: usize,
        /// The offending coordinate.
        value: f64,
    },
    /// A reference value (the true magnitude) is not finite, or larger than any axis can show.
    #[error("the reference value {value} cannot be drawn")]
    ReferenceNotDrawable {
        /// The offending value.
        value: f64,
    },
    /// The drawing library failed.
    #[error("the figure could not be drawn")]
    Drawing(#[from] DrawingFailure),
    /// The finished figure could not be stored.
    #[error("{} could not be written", path.display())]
    Write {
        /// Where the figure was to go.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
}

/// What the drawing library reports when it fails.
pub type DrawingFailure = DrawingAreaErrorKind<io::Error>;

/// A whole SVG document, or a rectangular part of one, in pixels.
type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;

/// Runs `draw` on a white canvas of `size` (width, height) pixels and returns the SVG document.
fn render_svg(
    size: (u32, u32),
    draw: impl FnOnce(&Canvas<'_>) -> Result<(), DrawingFailure>,
) -> Result<String, PlotError> {
    let mut svg = String::new();
    let canvas = SVGBackend::with_string(&mut svg, size).into_drawing_area();
    canvas.fill(&WHITE)?;
    draw(&canvas)?;
    canvas.present()?;
    drop(canvas);
    Ok(svg)
}

fn write_svg(svg: &str, path: &Path) -> Result<(), PlotError> {
    std::fs::write(path, svg).map_err(|source| PlotError::Write { path: path.to_owned(), source })
}

/// Refuses an empty slice, and a slice with a point one of whose `coordinates` is not finite or beyond `largest`.
fn check_points<Point, const COORDINATES: usize>(
    points: &[Point],
    largest: f64,
    coordinates: impl Fn(&Point) -> [f64; COORDINATES],
) -> Result<(), PlotError> {
    if points.is_empty() {
        return Err(PlotError::Empty);
    }
    for (index, point) in points.iter().enumerate() {
        // Written so that NaN, which compares with nothing, is found as well.
        let fits = |value: &f64| value.abs() <= largest;
        if let Some(value) = coordinates(point).into_iter().find(|value| !fits(value)) {
            return Err(PlotError::NotDrawable { index, value });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{PlotError, check_points, render_svg, write_svg};

    #[test]
    fn the_first_coordinate_that_cannot_be_drawn_is_named() {
        for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 8.5] {
            let refused = check_points(&[[0.0, 1.0], [2.0, bad]], 8.0, |point| *point);
            let Err(PlotError::NotDrawable { index: 1, value }) = refused else {
                panic!("{bad} passed: {refused:?}");
            };
            assert_eq!(value.to_bits(), bad.to_bits());
        }
        assert!(check_points(&[[8.0, -8.0]], 8.0, |point| *point).is_ok());
    }

    #[test]
    fn nothing_to_show_is_refused() {
        assert!(matches!(check_points(&[], 8.0, |point: &[f64; 2]| *point), Err(PlotError::Empty)));
    }

    #[test]
    fn a_document_is_closed_even_when_nothing_is_drawn_on_it() {
        let svg = render_svg((20, 10), |_| Ok(())).unwrap();
        assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"), "{svg}");
    }

    #[test]
    fn a_path_that_cannot_be_written_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("missing").join("figure.svg");
        assert!(
            matches!(write_svg("<svg/>", &path), Err(PlotError::Write { path: named, .. }) if named == path)
        );
    }
}
