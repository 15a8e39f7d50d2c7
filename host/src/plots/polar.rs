//! Recovered motion in polar coordinates: magnitude over direction in the plane (paper figure 5).
//!
//! One dot a sample: the load that shape from motion recovered, in unit loads (1 is the weight that hung on the sensor),
//! with the true unit circle over it. Dots on the circle mean a constant magnitude, dots all round it a motion
//! that spans. The angle counts from the trial's own x axis: before the known loads are applied, that axis points
//! anywhere, so the figure shows the shape of the motion and not where it began.
//!
//! The scale of the radius stands below the plot, not in it, where the dots would cover it.
//!
//! Failure: no samples, or a coordinate that cannot be drawn.

use std::path::Path;

use plotters::prelude::{Circle, Color, PathElement};
use plotters::style::text_anchor::HPos;

use super::axes::{Frame, plane};
use super::style::{BLUE, GRID, INK, LABEL_SIZE, Mark, TICK_SIZE, TITLE_SIZE, legend_entry, line, text};
use super::ticks::Ticks;
use super::{Canvas, DrawingFailure, LARGEST_UNIT_LOADS, PlotError, check_points, render_svg, write_svg};

/// The load of one sample in the plane of the picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlanarLoad {
    /// Along the trial's x axis, in unit loads.
    pub x_unit_loads: f64,
    /// Along the trial's y axis, in unit loads.
    pub y_unit_loads: f64,
}

/// Width and height of the figure in pixels.
const SIZE: (u32, u32) = (1000, 1160);
/// The pixel of the origin.
const CENTRE: (i32, i32) = (500, 570);
/// Pixels from the origin to the outermost ring.
const RADIUS: i32 = 400;
/// The square around the outermost ring.
const SQUARE: Frame = Frame {
    left: CENTRE.0 - RADIUS,
    right: CENTRE.0 + RADIUS,
    top: CENTRE.1 - RADIUS,
    bottom: CENTRE.1 + RADIUS,
};
/// Pixels from the origin to the middle of an angle's label.
const ANGLE_LABEL_RADIUS: f64 = 444.0;
/// The row of the scale of the radius, below the lowest angle label.
const SCALE_ROW: i32 = 1055;
/// The outermost ring, in unit loads, while every sample lies inside it.
const USUAL_LIMIT: f64 = 1.2;

/// Writes the figure to `path`.
///
/// # Errors
/// As [`render`], and [`PlotError::Write`].
pub fn draw(samples: &[PlanarLoad], path: &Path) -> Result<(), PlotError> {
    write_svg(&render(samples)?, path)
}

/// The figure as an SVG document.
///
/// # Errors
/// [`PlotError::Empty`], [`PlotError::NotDrawable`].
pub fn render(samples: &[PlanarLoad]) -> Result<String, PlotError> {
    check_points(samples, LARGEST_UNIT_LOADS, |sample| [sample.x_unit_loads, sample.y_unit_loads])?;
    let largest =
        samples.iter().map(|sample| sample.x_unit_loads.hypot(sample.y_unit_loads)).fold(0.0, f64::max);
    let limit = USUAL_LIMIT.max(1.02 * largest);
    let rings = Ticks::over(&(0.0..limit), 6);
    render_svg(SIZE, |canvas| {
        let title = format!("Recovered motion: magnitude and direction, {} samples", samples.len());
        canvas.draw_text(&title, &text(TITLE_SIZE, HPos::Center), (CENTRE.0, 34))?;
        legend_entry(canvas, (190, 84), &Mark::Dot(BLUE), "recovered load, one sample")?;
        legend_entry(canvas, (610, 84), &Mark::Line(line(INK, 3)), "true unit circle")?;
        draw_grid(canvas, &rings, limit)?;
        draw_radius_scale(canvas, &rings, limit)?;
        draw_samples(canvas, samples, limit)
    })
}

fn draw_samples(canvas: &Canvas<'_>, samples: &[PlanarLoad], limit: f64) -> Result<(), DrawingFailure> {
    let plane = plane(canvas, SQUARE, -limit..limit, -limit..limit);
    // Thousands of samples shall not close up into a ring that hides their scatter.
    let dot_radius = if samples.len() <= 400 { 6 } else { 3 };
    for sample in samples {
        let at = (sample.x_unit_loads, sample.y_unit_loads);
        plane.draw(&Circle::new(at, dot_radius, BLUE.mix(0.75).filled()))?;
    }
    let unit_radius = plane.map_coordinate(&(1.0, 0.0)).0 - CENTRE.0;
    canvas.draw(&Circle::new(CENTRE, unit_radius, line(INK, 3)))
}

/// Rings at the ticks of the radius and at its limit, and a spoke with its label every 30 degrees.
fn draw_grid(canvas: &Canvas<'_>, rings: &Ticks, limit: f64) -> Result<(), DrawingFailure> {
    let plane = plane(canvas, SQUARE, -limit..limit, -limit..limit);
    for ring in &rings.positions {
        let radius = plane.map_coordinate(&(*ring, 0.0)).0 - CENTRE.0;
        canvas.draw(&Circle::new(CENTRE, radius, line(GRID, 2)))?;
    }
    canvas.draw(&Circle::new(CENTRE, RADIUS, line(INK, 2)))?;
    for degrees in (0..360).step_by(30) {
        let (sine, cosine) = f64::from(degrees).to_radians().sin_cos();
        let rim = (limit * cosine, limit * sine);
        plane.draw(&PathElement::new(vec![(0.0, 0.0), rim], line(GRID, 2)))?;
        let reach = limit * ANGLE_LABEL_RADIUS / f64::from(RADIUS);
        let beyond_rim = plane.map_coordinate(&(reach * cosine, reach * sine));
        canvas.draw_text(&format!("{degrees}°"), &text(TICK_SIZE, HPos::Center), beyond_rim)?;
    }
    Ok(())
}

/// The scale of the radius, drawn below the plot from under the origin to under the outermost ring.
fn draw_radius_scale(canvas: &Canvas<'_>, rings: &Ticks, limit: f64) -> Result<(), DrawingFailure> {
    let plane = plane(canvas, SQUARE, -limit..limit, -limit..limit);
    let ends = vec![(CENTRE.0, SCALE_ROW), (CENTRE.0 + RADIUS, SCALE_ROW)];
    canvas.draw(&PathElement::new(ends, line(INK, 2)))?;
    for ring in &rings.positions {
        let column = plane.map_coordinate(&(*ring, 0.0)).0;
        let tick = vec![(column, SCALE_ROW), (column, SCALE_ROW + 10)];
        canvas.draw(&PathElement::new(tick, line(INK, 2)))?;
        canvas.draw_text(&rings.label(*ring), &text(TICK_SIZE, HPos::Center), (column, SCALE_ROW + 30))?;
    }
    let below_numbers = (CENTRE.0 + RADIUS / 2, SCALE_ROW + 72);
    canvas.draw_text("radius: magnitude (unit loads)", &text(LABEL_SIZE, HPos::Center), below_numbers)?;
    let beside = (CENTRE.0 - RADIUS / 2, SCALE_ROW + 72);
    canvas.draw_text("angle: direction in the xy plane (degrees)", &text(LABEL_SIZE, HPos::Center), beside)
}

#[cfg(test)]
mod tests {
    use super::{PlanarLoad, draw, render};
    use crate::plots::PlotError;

    const EAST: PlanarLoad = PlanarLoad { x_unit_loads: 1.0, y_unit_loads: 0.0 };

    #[test]
    fn every_sample_is_drawn_once() {
        let pictures = [1, 2, 7].map(|count| render(&vec![EAST; count]).unwrap());
        let circles = pictures.map(|svg| svg.matches("<circle").count());
        assert_eq!(circles[1] - circles[0], 1);
        assert_eq!(circles[2] - circles[0], 6);
    }

    #[test]
    fn a_unit_load_is_drawn_on_the_unit_circle() {
        // The dots are the only filled circles, the unit circle is the last one.
        let svg = render(&[EAST]).unwrap();
        let circles: Vec<&str> = svg.lines().filter(|line| line.starts_with("<circle")).collect();
        let number = |line: &str, name: &str| -> i32 {
            let (_, rest) = line.split_once(&format!(" {name}=\"")).unwrap();
            rest.split('"').next().unwrap().parse().unwrap()
        };
        let [.., dot, unit_circle] = circles[..] else { panic!("{svg}") };
        assert_eq!(number(dot, "cx"), number(unit_circle, "cx") + number(unit_circle, "r"));
        assert_eq!(number(dot, "cy"), number(unit_circle, "cy"));
    }

    #[test]
    fn no_samples_and_samples_without_a_place_are_refused() {
        assert!(matches!(render(&[]), Err(PlotError::Empty)));
        let nowhere = PlanarLoad { x_unit_loads: f64::INFINITY, ..EAST };
        assert!(matches!(render(&[EAST, nowhere]), Err(PlotError::NotDrawable { index: 1, .. })));
    }

    #[test]
    fn a_refused_figure_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("polar.svg");
        assert!(draw(&[], &path).is_err());
        assert!(!path.exists());
        draw(&[EAST], &path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), render(&[EAST]).unwrap());
    }
}
