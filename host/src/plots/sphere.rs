//! Recovered motion of a spatial trial: three orthogonal views of the unit sphere (paper figure 6).
//!
//! The panels show the recovered loads, in unit loads, along the plane's two axes; the third axis points at the reader,
//! so that every view is of a right-handed frame. Loads on the near half of the sphere are filled dots, those on the far
//! half open rings. The circle is the outline of the true sphere: no dot belongs outside it, and a panel with an
//! empty sector shows a motion that did not go there. As in the planar figure the trial's axes point anywhere.
//!
//! Failure: no samples, or a coordinate that cannot be drawn.

use std::path::Path;

use plotters::prelude::{Circle, Color};
use plotters::style::text_anchor::HPos;

use super::axes::{Axis, Frame, draw_axes};
use super::style::{BLUE, INK, LABEL_SIZE, Mark, TITLE_SIZE, VERMILLION, legend_entry, line, text};
use super::ticks::Ticks;
use super::{Canvas, DrawingFailure, LARGEST_UNIT_LOADS, PlotError, check_points, render_svg, write_svg};

/// The load of one sample as recovered from a spatial trial.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SpatialLoad {
    /// Along the trial's x axis, in unit loads.
    pub x_unit_loads: f64,
    /// Along the trial's y axis, in unit loads.
    pub y_unit_loads: f64,
    /// Along the trial's z axis, in unit loads.
    pub z_unit_loads: f64,
}

/// One orthogonal view: which axes the panel shows, and from where one looks.
struct View {
    across: &'static str,
    up: &'static str,
    seen_from: &'static str,
    /// The load's components across, up, and towards the reader.
    project: fn(&SpatialLoad) -> [f64; 3],
}

const VIEWS: [View; 3] = [
    View {
        across: "x",
        up: "y",
        seen_from: "seen from +z",
        project: |load| [load.x_unit_loads, load.y_unit_loads, load.z_unit_loads],
    },
    View {
        across: "x",
        up: "z",
        seen_from: "seen from −y",
        project: |load| [load.x_unit_loads, load.z_unit_loads, -load.y_unit_loads],
    },
    View {
        across: "y",
        up: "z",
        seen_from: "seen from +x",
        project: |load| [load.y_unit_loads, load.z_unit_loads, load.x_unit_loads],
    },
];

/// Width and height of the figure in pixels.
const SIZE: (u32, u32) = (1600, 660);
/// The left edge of each panel's square.
const PANEL_LEFT: [i32; 3] = [125, 645, 1165];
/// The top edge of the squares.
const PANEL_TOP: i32 = 164;
/// Width and height of a panel's square.
const PANEL_SIDE: i32 = 400;
/// Every axis reaches at least this far, in unit loads.
const USUAL_LIMIT: f64 = 1.2;

/// Writes the figure to `path`.
///
/// # Errors
/// As [`render`], and [`PlotError::Write`].
pub fn draw(samples: &[SpatialLoad], path: &Path) -> Result<(), PlotError> {
    write_svg(&render(samples)?, path)
}

/// The figure as an SVG document.
///
/// # Errors
/// [`PlotError::Empty`], [`PlotError::NotDrawable`].
pub fn render(samples: &[SpatialLoad]) -> Result<String, PlotError> {
    let components = |load: &SpatialLoad| [load.x_unit_loads, load.y_unit_loads, load.z_unit_loads];
    check_points(samples, LARGEST_UNIT_LOADS, components)?;
    let largest =
        samples.iter().flat_map(components).fold(0.0, |largest: f64, value| largest.max(value.abs()));
    let limit = USUAL_LIMIT.max(1.02 * largest);
    render_svg(SIZE, |canvas| {
        let title = format!("Recovered motion of a spatial trial, {} samples", samples.len());
        canvas.draw_text(&title, &text(TITLE_SIZE, HPos::Center), (800, 34))?;
        legend_entry(canvas, (285, 84), &Mark::Dot(BLUE), "near half of the sphere")?;
        legend_entry(canvas, (675, 84), &Mark::Ring(VERMILLION), "far half")?;
        legend_entry(canvas, (905, 84), &Mark::Line(line(INK, 3)), "outline of the true unit sphere")?;
        for (view, left) in VIEWS.iter().zip(PANEL_LEFT) {
            draw_panel(canvas, view, left, samples, limit)?;
        }
        Ok(())
    })
}

fn draw_panel(
    canvas: &Canvas<'_>,
    view: &View,
    left: i32,
    samples: &[SpatialLoad],
    limit: f64,
) -> Result<(), DrawingFailure> {
    let frame = Frame { left, right: left + PANEL_SIDE, top: PANEL_TOP, bottom: PANEL_TOP + PANEL_SIDE };
    let axis = |name: &str| Axis {
        range: -limit..limit,
        ticks: Ticks::over(&(-limit..limit), 6),
        description: format!("{name} (unit loads)"),
    };
    let plane = draw_axes(canvas, frame, &axis(view.across), &axis(view.up))?;
    let above = (left + PANEL_SIDE / 2, PANEL_TOP - 26);
    canvas.draw_text(view.seen_from, &text(LABEL_SIZE, HPos::Center), above)?;

    // Thousands of samples shall not close up into a disc.
    let dot_radius = if samples.len() <= 400 { 5 } else { 3 };
    // The far half first, as it lies behind the near one.
    for [across, up, towards] in samples.iter().map(view.project) {
        if towards < 0.0 {
            plane.draw(&Circle::new((across, up), dot_radius, line(VERMILLION, 1)))?;
        }
    }
    for [across, up, towards] in samples.iter().map(view.project) {
        if towards >= 0.0 {
            plane.draw(&Circle::new((across, up), dot_radius, BLUE.mix(0.75).filled()))?;
        }
    }

    let centre = plane.map_coordinate(&(0.0, 0.0));
    let unit_radius = plane.map_coordinate(&(1.0, 0.0)).0 - centre.0;
    canvas.draw(&Circle::new(centre, unit_radius, line(INK, 3)))
}

#[cfg(test)]
mod tests {
    use super::{SpatialLoad, VIEWS, draw, render};
    use crate::plots::PlotError;

    const UPRIGHT: SpatialLoad = SpatialLoad { x_unit_loads: 0.0, y_unit_loads: 0.0, z_unit_loads: 1.0 };

    #[test]
    fn every_view_is_of_a_right_handed_frame() {
        let along = |x, y, z| SpatialLoad { x_unit_loads: x, y_unit_loads: y, z_unit_loads: z };
        for view in VIEWS {
            let [ex, ey, ez] = [along(1.0, 0.0, 0.0), along(0.0, 1.0, 0.0), along(0.0, 0.0, 1.0)]
                .map(|load| (view.project)(&load));
            let determinant = ex[0] * (ey[1] * ez[2] - ey[2] * ez[1])
                - ey[0] * (ex[1] * ez[2] - ex[2] * ez[1])
                + ez[0] * (ex[1] * ey[2] - ex[2] * ey[1]);
            assert!((determinant - 1.0).abs() < f64::EPSILON, "{}: {determinant}", view.seen_from);
        }
    }

    #[test]
    fn every_sample_is_drawn_once_a_panel() {
        let pictures = [1, 2, 7].map(|count| render(&vec![UPRIGHT; count]).unwrap());
        let circles = pictures.map(|svg| svg.matches("<circle").count());
        assert_eq!(circles[1] - circles[0], 3);
        assert_eq!(circles[2] - circles[0], 18);
    }

    #[test]
    fn no_samples_and_samples_without_a_place_are_refused() {
        assert!(matches!(render(&[]), Err(PlotError::Empty)));
        let nowhere = SpatialLoad { y_unit_loads: f64::NAN, ..UPRIGHT };
        assert!(matches!(render(&[UPRIGHT, nowhere]), Err(PlotError::NotDrawable { index: 1, .. })));
    }

    #[test]
    fn a_refused_figure_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("sphere.svg");
        assert!(draw(&[], &path).is_err());
        assert!(!path.exists());
        draw(&[UPRIGHT], &path).unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), render(&[UPRIGHT]).unwrap());
    }
}
