//! Colours, letter sizes and marks that the figures share.
//!
//! Sizes are in pixels of a canvas about 1200 wide; an SVG scales, so only the proportions matter.

use plotters::prelude::{Circle, Color, IntoFont, PathElement, RGBColor, Rectangle, ShapeStyle, TextStyle};
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::{Canvas, DrawingFailure};

/// Shape from motion, and what it recovered (Okabe and Ito's blue).
pub(super) const BLUE: RGBColor = RGBColor(0, 114, 178);
/// What is compared with it (Okabe and Ito's vermillion).
pub(super) const VERMILLION: RGBColor = RGBColor(213, 94, 0);
/// Letters, axes and the truth.
pub(super) const INK: RGBColor = RGBColor(25, 25, 25);
/// Grid lines, behind everything.
pub(super) const GRID: RGBColor = RGBColor(215, 215, 215);

/// Height of a figure's title.
pub(super) const TITLE_SIZE: u32 = 34;
/// Height of axis descriptions and legends.
pub(super) const LABEL_SIZE: u32 = 28;
/// Height of the numbers at the ticks.
pub(super) const TICK_SIZE: u32 = 25;

/// Letters of `size` whose `horizontal` edge (and vertical middle) is at the point they are drawn at.
pub(super) fn text(size: u32, horizontal: HPos) -> TextStyle<'static> {
    TextStyle::from(("sans-serif", size).into_font()).color(&INK).pos(Pos::new(horizontal, VPos::Center))
}

/// A line of `width` pixels.
pub(super) fn line(color: RGBColor, width: u32) -> ShapeStyle {
    color.stroke_width(width)
}

/// What stands before the words of a legend entry.
pub(super) enum Mark {
    /// A filled dot.
    Dot(RGBColor),
    /// An open ring.
    Ring(RGBColor),
    /// A line, as long as the entry's mark is wide.
    Line(ShapeStyle),
    /// A line of dashes.
    Dashes(ShapeStyle),
    /// A line with a filled square on it.
    LineWithSquare(RGBColor),
    /// A line of dots with a filled, larger dot on it.
    DotsWithDot(RGBColor),
}

/// Width in pixels that a legend entry's mark takes, gap to the words included.
const MARK_WIDTH: i32 = 76;
/// Half of the width of the mark itself.
const HALF_MARK: i32 = 30;

/// Draws one legend entry with its left edge and vertical middle at `(left, middle)`.
pub(super) fn legend_entry(
    canvas: &Canvas<'_>,
    (left, middle): (i32, i32),
    mark: &Mark,
    words: &str,
) -> Result<(), DrawingFailure> {
    let centre = left + HALF_MARK;
    let whole = [(left, middle), (left + 2 * HALF_MARK, middle)];
    match mark {
        Mark::Dot(color) => canvas.draw(&Circle::new((left + MARK_WIDTH - 24, middle), 6, color.filled()))?,
        Mark::Ring(color) => {
            canvas.draw(&Circle::new((left + MARK_WIDTH - 24, middle), 6, line(*color, 2)))?;
        }
        Mark::Line(style) => canvas.draw(&PathElement::new(whole.to_vec(), *style))?,
        Mark::Dashes(style) => {
            for dash in [left, left + 22, left + 44] {
                canvas.draw(&PathElement::new(vec![(dash, middle), (dash + 14, middle)], *style))?;
            }
        }
        Mark::LineWithSquare(color) => {
            canvas.draw(&PathElement::new(whole.to_vec(), line(*color, 3)))?;
            canvas.draw(&square((centre, middle), *color))?;
        }
        Mark::DotsWithDot(color) => {
            for dot in [left, left + 10, left + 50, left + 60] {
                canvas.draw(&Circle::new((dot, middle), DOT_OF_LINE, color.filled()))?;
            }
            canvas.draw(&Circle::new((centre, middle), MARKER, color.filled()))?;
        }
    }
    canvas.draw_text(words, &text(LABEL_SIZE, HPos::Left), (left + MARK_WIDTH, middle))
}

/// Radius of one dot of a dotted line.
pub(super) const DOT_OF_LINE: i32 = 2;
/// Radius of a marker that stands for one value.
pub(super) const MARKER: i32 = 8;

/// A filled square marker around a pixel.
pub(super) fn square((x, y): (i32, i32), color: RGBColor) -> Rectangle<(i32, i32)> {
    Rectangle::new([(x - MARKER, y - MARKER), (x + MARKER, y + MARKER)], color.filled())
}
