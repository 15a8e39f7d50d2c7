//! Force magnitude as the orientation changes, both calibrations applied to the same samples (paper figure 8).
//!
//! Shape from motion above, least squares below, on the same scale, each with the true magnitude as a dashed line. The
//! weight is constant, so every wave in a curve is an error of the calibration and not of the load. The title
//! of each panel states mean ± standard deviation in newton, over the samples shown (the population's: the samples are
//! all there is to describe).
//!
//! Failure: no samples, or a magnitude or a true magnitude that cannot be drawn.

use std::ops::Range;
use std::path::Path;

use plotters::element::DashedPathElement;
use plotters::prelude::{Circle, Color, PathElement, RGBColor};
use plotters::style::text_anchor::HPos;

use super::axes::{Axis, Frame, draw_axes};
use super::style::{BLUE, INK, Mark, TITLE_SIZE, VERMILLION, legend_entry, line, text};
use super::ticks::{Ticks, padded_range};
use super::{Canvas, DrawingFailure, LARGEST_VALUE, PlotError, check_points, render_svg, write_svg};

/// The force magnitude that either calibration gives for one sample.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MagnitudeSample {
    /// By the shape-from-motion calibration.
    pub shape_from_motion_newton: f64,
    /// By the least-squares calibration (eq. 3).
    pub least_squares_newton: f64,
}

/// Width and height of the figure in pixels.
const SIZE: (u32, u32) = (1200, 1135);
/// Up to so many samples are marked with a dot each; a line alone would show nothing of a single one.
const FEW_SAMPLES: usize = 150;
/// The frame of the upper panel.
const UPPER: Frame = Frame { left: 140, right: 1160, top: 130, bottom: 500 };
/// The frame of the lower panel, as high as the upper one.
const LOWER: Frame = Frame { left: 140, right: 1160, top: 665, bottom: 1035 };

/// Writes the figure to `path`; `true_newton` is the weight that hung on the sensor.
///
/// # Errors
/// As [`render`], and [`PlotError::Write`].
pub fn draw(samples: &[MagnitudeSample], true_newton: f64, path: &Path) -> Result<(), PlotError> {
    write_svg(&render(samples, true_newton)?, path)
}

/// The figure as an SVG document; `true_newton` is the weight that hung on the sensor.
///
/// # Errors
/// [`PlotError::Empty`], [`PlotError::NotDrawable`], [`PlotError::ReferenceNotDrawable`].
pub fn render(samples: &[MagnitudeSample], true_newton: f64) -> Result<String, PlotError> {
    check_points(samples, LARGEST_VALUE, |sample| {
        [sample.shape_from_motion_newton, sample.least_squares_newton]
    })?;
    if !true_newton.is_finite() || true_newton.abs() > LARGEST_VALUE {
        return Err(PlotError::ReferenceNotDrawable { value: true_newton });
    }
    let upper = Curve {
        method: "Shape from motion",
        color: BLUE,
        newton: samples.iter().map(|sample| sample.shape_from_motion_newton).collect(),
    };
    let lower = Curve {
        method: "Least squares",
        color: VERMILLION,
        newton: samples.iter().map(|sample| sample.least_squares_newton).collect(),
    };
    let newton_range = padded_range(upper.newton.iter().chain(&lower.newton).copied().chain([true_newton]));
    let true_magnitude = TrueMagnitude { newton: true_newton, newton_range };
    render_svg(SIZE, |canvas| {
        let decimals = decimals_for(upper.spread().min(lower.spread()));
        let legend = format!("true magnitude {true_newton:.decimals$} N");
        legend_entry(canvas, (440, 40), &Mark::Dashes(line(INK, 3)), &legend)?;
        upper.draw(canvas, UPPER, &true_magnitude)?;
        lower.draw(canvas, LOWER, &true_magnitude)
    })
}

/// What the two panels have in common.
struct TrueMagnitude {
    newton: f64,
    newton_range: Range<f64>,
}

/// The magnitudes that one method gives.
struct Curve {
    method: &'static str,
    color: RGBColor,
    newton: Vec<f64>,
}

impl Curve {
    fn mean(&self) -> f64 {
        self.newton.iter().sum::<f64>() / self.newton.len() as f64
    }

    /// Standard deviation about the mean, in newton.
    fn spread(&self) -> f64 {
        let mean = self.mean();
        let squares: f64 = self.newton.iter().map(|newton| (newton - mean).powi(2)).sum();
        (squares / self.newton.len() as f64).sqrt()
    }

    fn title(&self) -> String {
        let (mean, spread) = (self.mean(), self.spread());
        let decimals = decimals_for(spread);
        format!("{}: {mean:.decimals$} ± {spread:.decimals$} N (mean ± std)", self.method)
    }

    fn draw(&self, canvas: &Canvas<'_>, frame: Frame, truth: &TrueMagnitude) -> Result<(), DrawingFailure> {
        let above = (frame.left + (frame.right - frame.left) / 2, frame.top - 30);
        canvas.draw_text(&self.title(), &text(TITLE_SIZE, HPos::Center), above)?;

        let count = self.newton.len();
        let ends = (0.5, count as f64 + 0.5);
        let across = Axis {
            range: ends.0..ends.1,
            ticks: Ticks::counting(count, 10),
            description: "sample number".to_owned(),
        };
        let up = Axis {
            range: truth.newton_range.clone(),
            ticks: Ticks::over(&truth.newton_range, 6),
            description: "force magnitude (N)".to_owned(),
        };
        let plane = draw_axes(canvas, frame, &across, &up)?;

        let points: Vec<(f64, f64)> =
            self.newton.iter().enumerate().map(|(index, newton)| (index as f64 + 1.0, *newton)).collect();
        if count <= FEW_SAMPLES {
            for point in &points {
                plane.draw(&Circle::new(*point, 4, self.color.filled()))?;
            }
        }
        plane.draw(&PathElement::new(points, line(self.color, 2)))?;
        let true_line = [(ends.0, truth.newton), (ends.1, truth.newton)];
        plane.draw(&DashedPathElement::new(true_line, 14, 8, line(INK, 3)))
    }
}

/// Decimals that show two digits of a standard deviation: two to six, or three when there is none to show.
fn decimals_for(spread: f64) -> usize {
    let mut scaled = spread * 100.0;
    for decimals in 2..=6 {
        if scaled >= 10.0 {
            return decimals;
        }
        scaled *= 10.0;
    }
    3
}

#[cfg(test)]
mod tests {
    use super::{LOWER, MagnitudeSample, UPPER, draw, render};
    use crate::plots::PlotError;

    fn sample(shape_from_motion_newton: f64, least_squares_newton: f64) -> MagnitudeSample {
        MagnitudeSample { shape_from_motion_newton, least_squares_newton }
    }

    #[test]
    fn the_titles_state_mean_and_standard_deviation() {
        // ±a in equal numbers has the mean in the middle and the standard deviation a.
        let samples = [sample(25.15, 25.0), sample(25.25, 26.0)];
        let svg = render(&samples, 25.24).unwrap();
        assert!(svg.contains("Shape from motion: 25.200 ± 0.050 N"), "{svg}");
        assert!(svg.contains("Least squares: 25.50 ± 0.50 N"), "{svg}");
    }

    #[test]
    fn both_panels_have_one_scale() {
        // Each curve alone would ask for ticks of its own.
        let svg = render(&[sample(25.0, 20.0), sample(25.1, 30.0)], 25.24).unwrap();
        let numbers = |frame: super::Frame| -> Vec<&str> {
            let right_aligned = format!("<text x=\"{}\"", frame.left - 14);
            let mut lines = svg.lines();
            let mut numbers = Vec::new();
            while let Some(line) = lines.next() {
                if line.starts_with(&right_aligned) {
                    numbers.extend(lines.next());
                }
            }
            numbers
        };
        let all = numbers(UPPER);
        let (upper, lower) = all.split_at(all.len() / 2);
        assert_eq!(upper, lower);
        assert!(upper.len() >= 2);
        assert_eq!(UPPER.bottom - UPPER.top, LOWER.bottom - LOWER.top);
    }

    #[test]
    fn one_sample_and_no_spread_can_be_drawn() {
        let svg = render(&[sample(25.24, 25.24)], 25.24).unwrap();
        assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
    }

    #[test]
    fn what_cannot_be_drawn_is_refused() {
        assert!(matches!(render(&[], 25.24), Err(PlotError::Empty)));
        let broken = [sample(25.0, 25.0), sample(25.0, f64::NAN)];
        assert!(matches!(render(&broken, 25.24), Err(PlotError::NotDrawable { index: 1, .. })));
        assert!(matches!(render(&broken[..1], f64::NAN), Err(PlotError::ReferenceNotDrawable { .. })));
    }

    #[test]
    fn a_refused_figure_leaves_no_file() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("magnitude.svg");
        assert!(draw(&[], 25.24, &path).is_err());
        assert!(!path.exists());
        draw(&[sample(25.0, 25.0)], 25.24, &path).unwrap();
        assert!(path.exists());
    }
}
