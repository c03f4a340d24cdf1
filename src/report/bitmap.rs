//! Dense heat maps as a bitmap inside the page.
//!
//! A rectangle for each of some 60 000 cells would weigh megabytes and show seams where neighbours are smoothed against
//! each other; a bitmap with a palette takes one byte a cell. BMP needs no compression and so no library.

/// A `data:` address of a BMP with at most 256 colours; `rows` hold palette indices, the first row at the bottom, all of
/// one length.
pub(super) fn data_url(rows: &[Vec<u8>], palette: &[[u8; 3]]) -> String {
    format!("data:image/bmp;base64,{}", base64(&bitmap(rows, palette)))
}

fn bitmap(rows: &[Vec<u8>], palette: &[[u8; 3]]) -> Vec<u8> {
    let width = rows.first().map_or(0, Vec::len);
    let stride = width.next_multiple_of(4);
    let start = 14 + 40 + 4 * palette.len();
    let size = start + stride * rows.len();
    let mut out = Vec::with_capacity(size);
    let pixels = stride * rows.len();
    // Value and number of bytes of each field of the two headers.
    let file = [(0x4d42, 2), (size, 4), (0, 4), (start, 4)];
    // Header size, width, height (positive: rows from the bottom), planes, bits, no compression, size of the pixels.
    let image = [(40, 4), (width, 4), (rows.len(), 4), (1, 2), (8, 2), (0, 4), (pixels, 4)];
    // Resolution both ways (none), colours used, all of them important.
    let colors = [(0, 4), (0, 4), (palette.len(), 4), (0, 4)];
    for (value, bytes) in file.into_iter().chain(image).chain(colors) {
        out.extend_from_slice(&(value as u64).to_le_bytes()[..bytes]);
    }
    palette.iter().for_each(|[red, green, blue]| out.extend_from_slice(&[*blue, *green, *red, 0]));
    for row in rows {
        out.extend_from_slice(row);
        out.extend(std::iter::repeat_n(0, stride - width));
    }
    out
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut out = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for three in bytes.chunks(3) {
        let bits = three.iter().fold(0u32, |bits, b| bits << 8 | u32::from(*b)) << (8 * (3 - three.len()));
        for i in 0..4 {
            let letter = LETTERS[(bits >> (18 - 6 * i)) as usize & 63] as char;
            out.push(if i <= three.len() { letter } else { '=' });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_matches_the_published_examples() {
        for (plain, coded) in [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn a_bitmap_states_its_own_size_and_pads_its_rows() {
        let image = bitmap(&[vec![0, 1, 0], vec![1, 1, 1]], &[[1, 2, 3], [255, 0, 0]]);
        assert_eq!(&image[..2], b"BM");
        assert_eq!(u32::from_le_bytes([image[2], image[3], image[4], image[5]]) as usize, image.len());
        assert_eq!(image.len(), 54 + 8 + 2 * 4);
        assert_eq!(&image[54..58], &[3, 2, 1, 0], "blue first");
        assert_eq!(&image[62..], &[0, 1, 0, 0, 1, 1, 1, 0]);
    }
}
