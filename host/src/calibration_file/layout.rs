//! JSON that a person can read: one field a line, one row of a matrix a line.

use std::io::{self, Write};

use serde::Serialize;
use serde_json::ser::{CompactFormatter, Formatter, PrettyFormatter, Serializer};

/// Writes `value` with line breaks, lists within lists on one line, and a final new line.
///
/// # Errors
///
/// Those of the destination.
pub(super) fn write(value: &impl Serialize, out: &mut impl Write) -> io::Result<()> {
    let layout = RowLayout { pretty: PrettyFormatter::new(), lists: 0 };
    value.serialize(&mut Serializer::with_formatter(&mut *out, layout)).map_err(io::Error::from)?;
    writeln!(out)
}

/// The usual layout outside of lists within lists, and a compact one inside.
struct RowLayout {
    pretty: PrettyFormatter<'static>,
    /// Lists begun and not ended.
    lists: usize,
}

impl RowLayout {
    const fn inside_row(&self) -> bool {
        self.lists > 1
    }
}

impl Formatter for RowLayout {
    fn begin_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.lists += 1;
        if self.inside_row() { CompactFormatter.begin_array(out) } else { self.pretty.begin_array(out) }
    }

    fn end_array<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        let inside_row = self.inside_row();
        self.lists -= 1;
        if inside_row { CompactFormatter.end_array(out) } else { self.pretty.end_array(out) }
    }

    fn begin_array_value<W: ?Sized + Write>(&mut self, out: &mut W, first: bool) -> io::Result<()> {
        if self.inside_row() {
            if first { Ok(()) } else { out.write_all(b", ") }
        } else {
            self.pretty.begin_array_value(out, first)
        }
    }

    fn end_array_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        if self.inside_row() {
            CompactFormatter.end_array_value(out)
        } else {
            self.pretty.end_array_value(out)
        }
    }

    fn begin_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.pretty.begin_object(out)
    }

    fn end_object<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.pretty.end_object(out)
    }

    fn begin_object_key<W: ?Sized + Write>(&mut self, out: &mut W, first: bool) -> io::Result<()> {
        self.pretty.begin_object_key(out, first)
    }

    fn begin_object_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.pretty.begin_object_value(out)
    }

    fn end_object_value<W: ?Sized + Write>(&mut self, out: &mut W) -> io::Result<()> {
        self.pretty.end_object_value(out)
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::write;

    #[test]
    fn rows_stand_on_one_line_and_the_value_is_unchanged() {
        let value = json!({
            "empty": [],
            "matrix": [[1.5, 2, 3], [], [4, 5, 6]],
            "trials": [{ "arm": [1, 2], "nested": { "a": null } }, {}],
            "list": [1, 2],
        });
        let mut text = Vec::new();
        write(&value, &mut text).expect("memory takes everything");
        assert_eq!(serde_json::from_slice::<Value>(&text).expect("JSON"), value);
        let text = String::from_utf8(text).expect("UTF-8");
        assert!(text.lines().any(|line| line.trim() == "[1.5, 2, 3],"), "{text}");
    }
}
