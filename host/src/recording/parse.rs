//! Reading a recording from CSV, with errors that say where, what was expected and what stood there.
//!
//! Tolerated: a byte-order mark, CRLF line ends, blank lines, spaces around fields, comment lines anywhere. Not tolerated:
//! anything that is not a finite number in a field, a line with a field too few or too many, another header.
//! The gain may stand in several lines (recordings are put together from pieces) if it is the same in all of them.
//! Time may go backwards (recordings are put together from pieces); a window of such a recording is refused.

use std::path::Path;

use ftcal_shared::units::{Gain, MAX_GAGES};

use super::{MIN_GAGES, Recording, shown};
use crate::gain;
use crate::place::Place;

/// What a line begins with, behind its `#`, that states the gain.
pub(super) const GAIN: &str = "converter gain:";

/// The largest count: beyond it, not every integer has an f64 of its own.
const LARGEST_COUNT: f64 = 9_007_199_254_740_992.0;

/// Why a file is not a recording.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The file cannot be read at all.
    #[error("{file}: cannot be read: {reason}")]
    Unreadable {
        /// The file.
        file: String,
        /// What the system said.
        reason: std::io::Error,
    },
    /// Something else stands where a part of a recording was expected.
    #[error("{file}: {place}: expected {expected}, found {found}")]
    Unexpected {
        /// The file.
        file: String,
        /// Where in the file.
        place: Place,
        /// What belongs there.
        expected: String,
        /// What stands there.
        found: String,
    },
}

/// Something unexpected, before the file's name is known.
struct Unexpected {
    place: Place,
    expected: String,
    found: String,
}

/// Reads a recording from a file.
///
/// # Errors
///
/// [`RecordingError`].
pub(super) fn read(path: &Path) -> Result<Recording, RecordingError> {
    let file = shown(path);
    let bytes =
        std::fs::read(path).map_err(|reason| RecordingError::Unreadable { file: file.clone(), reason })?;
    parse(&bytes, &file)
}

/// Reads a recording from the bytes of a CSV file; `file` names it in errors.
///
/// # Errors
///
/// [`RecordingError::Unexpected`].
pub fn parse(bytes: &[u8], file: &str) -> Result<Recording, RecordingError> {
    recording(bytes).map_err(|Unexpected { place, expected, found }| RecordingError::Unexpected {
        file: file.to_owned(),
        place,
        expected,
        found,
    })
}

fn recording(bytes: &[u8]) -> Result<Recording, Unexpected> {
    let text = text(bytes)?;
    let gain = gain_of_lines(text)?;
    let mut lines = (1..).zip(text.lines()).filter(|(_, line)| holds_data(line));
    let (header_line, header) = lines.next().ok_or_else(|| Unexpected {
        place: Place { line: 1, column: 1 },
        expected: "the header `t_s,ch0,ch1,…`".to_owned(),
        found: "no line that is neither blank nor a comment".to_owned(),
    })?;
    let gages = gages_of_header(header_line, header)?;

    let (mut times_s, mut counts) = (Vec::new(), Vec::new());
    for (line, fields) in lines {
        let found = fields.split(',').count();
        if found != gages + 1 {
            let column = found.min(gages + 1) + usize::from(found > gages + 1);
            return Err(Unexpected {
                place: Place { line, column },
                expected: format!("{} fields as in the header", gages + 1),
                found: format!("{found}"),
            });
        }
        for (column, field) in (1..).zip(fields.split(',')) {
            let value = number(Place { line, column }, field)?;
            if column == 1 { times_s.push(value) } else { counts.push(value) }
        }
    }
    if times_s.is_empty() {
        return Err(Unexpected {
            place: Place { line: text.lines().count() + 1, column: 1 },
            expected: "at least one sample".to_owned(),
            found: "the end of the file".to_owned(),
        });
    }
    Ok(Recording::from_counts(gages, times_s, &counts).at_gain(gain))
}

/// The text of the file, without its byte-order mark.
fn text(bytes: &[u8]) -> Result<&str, Unexpected> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let before = bytes.get(..error.valid_up_to()).unwrap_or_default();
        let line = before.split(|&byte| byte == b'\n').count();
        let begun = before.rsplit(|&byte| byte == b'\n').next().unwrap_or_default();
        let column = begun.split(|&byte| byte == b',').count();
        Unexpected {
            place: Place { line, column },
            expected: "text in UTF-8".to_owned(),
            found: "bytes that are no text".to_owned(),
        }
    })?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

fn holds_data(line: &str) -> bool {
    let line = line.trim();
    !line.is_empty() && !line.starts_with('#')
}

/// The gain that the recording states; `None` where it states none.
fn gain_of_lines(text: &str) -> Result<Option<Gain>, Unexpected> {
    let mut stated: Option<(usize, Gain)> = None;
    for (line, content) in (1..).zip(text.lines()) {
        let comment = content.trim().strip_prefix('#').map(str::trim);
        let Some(value) = comment.and_then(|comment| comment.strip_prefix(GAIN)).map(str::trim) else {
            continue;
        };
        let unexpected = |expected: String| Unexpected {
            place: Place { line, column: 1 },
            expected,
            found: quoted(value),
        };
        let gain = gain::of_text(value).ok_or_else(|| unexpected(gain::possible()))?;
        match stated {
            Some((first, other)) if other != gain => {
                return Err(unexpected(format!("gain {} as in line {first}", other.factor())));
            }
            _ => stated = stated.or(Some((line, gain))),
        }
    }
    Ok(stated.map(|(_, gain)| gain))
}

/// The number of gages that a header announces.
fn gages_of_header(line: usize, header: &str) -> Result<usize, Unexpected> {
    let names: Vec<&str> = header.split(',').map(str::trim).collect();
    for (position, &name) in names.iter().enumerate() {
        let expected = position.checked_sub(1).map_or_else(|| "t_s".to_owned(), |gage| format!("ch{gage}"));
        if name != expected {
            return Err(Unexpected {
                place: Place { line, column: position + 1 },
                expected: format!("`{expected}` of the header `t_s,ch0,ch1,…`"),
                found: quoted(name),
            });
        }
    }
    let gages = names.len() - 1;
    if (MIN_GAGES..=MAX_GAGES).contains(&gages) {
        Ok(gages)
    } else {
        Err(Unexpected {
            place: Place { line, column: names.len() },
            expected: format!("{MIN_GAGES} to {MAX_GAGES} gage channels"),
            found: format!("{gages}"),
        })
    }
}

fn number(place: Place, field: &str) -> Result<f64, Unexpected> {
    let field = field.trim();
    let unexpected = |expected: String| Unexpected { place, expected, found: quoted(field) };
    let name = if place.column == 1 { "t_s".to_owned() } else { format!("ch{}", place.column - 2) };
    let value: f64 = field.parse().map_err(|_| unexpected(format!("a number for {name}")))?;
    if !value.is_finite() {
        return Err(unexpected(format!("a finite number for {name}")));
    }
    if value.abs() > LARGEST_COUNT {
        return Err(unexpected(format!("a number for {name} that is within ±2⁵³")));
    }
    Ok(value)
}

/// What stood in the file, short enough for one line.
fn quoted(field: &str) -> String {
    const LONGEST: usize = 40;
    match field.char_indices().nth(LONGEST) {
        _ if field.is_empty() => "nothing".to_owned(),
        Some((end, _)) => format!("`{}…`", field.get(..end).unwrap_or_default().escape_debug()),
        None => format!("`{}`", field.escape_debug()),
    }
}

#[cfg(test)]
mod tests {
    use ftcal_shared::units::Gain;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::{RecordingError, parse};
    use crate::place::Place;

    fn place_of_error(text: &str) -> (Place, String) {
        match parse(text.as_bytes(), "rec.csv").expect_err("not a recording") {
            RecordingError::Unexpected { place, expected, .. } => (place, expected),
            RecordingError::Unreadable { .. } => panic!("no file was read"),
        }
    }

    #[test]
    fn comments_blank_lines_line_ends_and_byte_order_marks_change_nothing() {
        let plain = parse(b"t_s,ch0,ch1\n0,1,-2\n0.5,3,4\n", "plain").expect("a recording");
        for dressed in [
            "\u{feff}t_s,ch0,ch1\r\n0,1,-2\r\n0.5,3,4\r\n",
            "# made by hand\n\nt_s,ch0,ch1\n# rest\n0,1,-2\n  # more\n0.5,3,4\n\n   \n",
            " t_s , ch0,ch1\n0, 1 ,-2\n 5e-1,+3,4.0",
        ] {
            assert_eq!(parse(dressed.as_bytes(), "dressed").expect("a recording"), plain);
        }
    }

    #[test]
    fn the_gain_is_what_is_stated_wherever_that_is() {
        let gain = |text: &str| parse(text.as_bytes(), "rec.csv").expect("a recording").gain();
        assert_eq!(gain("t_s,ch0,ch1\n0,1,2\n"), None);
        assert_eq!(gain("# converter gain: 64\nt_s,ch0,ch1\n0,1,2\n"), Some(Gain::X64));
        assert_eq!(
            gain("t_s,ch0,ch1\r\n  #converter gain:1\r\n0,1,2\r\n# converter gain: 1"),
            Some(Gain::X1)
        );
        // Words about a gain are no statement of it.
        assert_eq!(gain("# gain: 500\n# at converter gain: 3\nt_s,ch0,ch1\n0,1,2\n"), None);
    }

    #[test]
    fn every_error_says_where() {
        for (text, line, column) in [
            ("", 1, 1),
            ("# nothing else\n", 1, 1),
            ("t_s,ch0,ch1\n", 2, 1),
            ("time,ch0,ch1\n0,1,2\n", 1, 1),
            ("t_s,ch0,ch2\n0,1,2\n", 1, 3),
            ("t_s,ch0\n0,1\n", 1, 2),
            ("t_s,ch0,ch1\n0,1,2\n\n# gap\n1,2\n", 5, 2),
            ("t_s,ch0,ch1\n0,1,2,3\n", 2, 4),
            ("t_s,ch0,ch1\n0,1,NaN\n", 2, 3),
            ("t_s,ch0,ch1\n0,inf,2\n", 2, 2),
            ("t_s,ch0,ch1\n-infinity,1,2\n", 2, 1),
            ("t_s,ch0,ch1\n0,,2\n", 2, 2),
            ("t_s,ch0,ch1\n0,1,0x12\n", 2, 3),
            ("t_s,ch0,ch1\n0,1,1e300\n", 2, 3),
            ("# converter gain: 3\nt_s,ch0,ch1\n0,1,2\n", 1, 1),
            ("# converter gain:\nt_s,ch0,ch1\n0,1,2\n", 1, 1),
            ("# converter gain: 64\nt_s,ch0,ch1\n0,1,2\n# converter gain: 128\n1,1,2\n", 4, 1),
            ("t_s,ch0,ch1,ch2,ch3,ch4,ch5,ch6,ch7,ch8,ch9,ch10,ch11,ch12\n", 1, 14),
        ] {
            assert_eq!(place_of_error(text).0, Place { line, column }, "{text:?}");
        }
    }

    #[test]
    fn bytes_that_are_no_text_are_located() {
        let error = parse(b"t_s,ch0,ch1\n0,1,2\n1,2,\xff\n", "rec.csv").expect_err("not text");
        assert!(error.to_string().starts_with("rec.csv: line 3, column 3: "), "{error}");
    }

    #[test]
    fn no_sequence_of_bytes_makes_the_reader_panic() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let pieces: [&[u8]; 12] =
            [b"t_s", b"ch0", b"ch1", b",", b"\n", b"\r", b"#", b"\"", b"1e400", b"-", b"\xc3\x28", b"0"];
        for _ in 0..2000 {
            let length = random.random_range(0..40);
            let header: &[u8] = if random.random() { b"t_s,ch0,ch1\n" } else { b"" };
            let tail = (0..length).flat_map(|_| pieces[random.random_range(0..pieces.len())]);
            let bytes: Vec<u8> = header.iter().chain(tail).copied().collect();
            let _ = parse(&bytes, "noise");
        }
    }
}
