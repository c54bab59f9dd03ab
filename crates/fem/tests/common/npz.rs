//! Reader of NumPy archives, as far as the tests need it: little-endian floats and integers in C
//! order, stored or deflated.

use std::collections::BTreeMap;
use std::io::{Error, Read};
use std::path::Path;

/// One array: its values as doubles, row by row.
#[derive(Debug, Clone)]
pub struct Array {
    pub values: Vec<f64>,
}

impl Array {
    /// Rows of three numbers.
    pub fn rows3(&self) -> Vec<[f64; 3]> {
        self.values.as_chunks::<3>().0.to_vec()
    }

    /// Rows of `N` indices.
    pub fn index_rows<const N: usize>(&self) -> Vec<[usize; N]> {
        self.values.as_chunks::<N>().0.iter().map(|row| row.map(|v| v as usize)).collect()
    }

    /// Indices.
    pub fn indices(&self) -> Vec<usize> {
        self.values.iter().map(|&v| v as usize).collect()
    }
}

/// Read all arrays of an archive by name.
pub fn read(path: &Path) -> Result<BTreeMap<String, Array>, Error> {
    let bytes = std::fs::read(path)?;
    let mut arrays = BTreeMap::new();
    let end = (0..bytes.len().saturating_sub(21))
        .rev()
        .find(|&k| bytes[k..].starts_with(b"PK\x05\x06"))
        .ok_or_else(|| Error::other("no archive"))?;
    let count = int(&bytes, end + 10, 2);
    let mut entry = int(&bytes, end + 16, 4);
    for _ in 0..count {
        let method = int(&bytes, entry + 10, 2);
        let packed = int(&bytes, entry + 20, 4);
        let [name, extra, comment] = [28, 30, 32].map(|k| int(&bytes, entry + k, 2));
        let local = int(&bytes, entry + 42, 4);
        let key = String::from_utf8_lossy(&bytes[entry + 46..entry + 46 + name]).into_owned();
        let data = local + 30 + int(&bytes, local + 26, 2) + int(&bytes, local + 28, 2);
        let mut raw = Vec::new();
        match method {
            0 => raw.extend_from_slice(&bytes[data..data + packed]),
            _ => {
                flate2::read::DeflateDecoder::new(&bytes[data..data + packed])
                    .read_to_end(&mut raw)?;
            }
        }
        arrays.insert(key.trim_end_matches(".npy").to_string(), array(&raw)?);
        entry += 46 + name + extra + comment;
    }
    Ok(arrays)
}

fn int(bytes: &[u8], at: usize, width: usize) -> usize {
    bytes[at..at + width].iter().rev().fold(0, |sum, &b| sum << 8 | usize::from(b))
}

fn array(raw: &[u8]) -> Result<Array, Error> {
    let length = int(raw, 8, 2);
    let header = String::from_utf8_lossy(&raw[10..10 + length]).into_owned();
    let data = &raw[10 + length..];
    let kind = header.split("'descr': '").nth(1).and_then(|rest| rest.split('\'').next());
    let values = match kind {
        Some("<f8") => data.as_chunks::<8>().0.iter().map(|b| f64::from_le_bytes(*b)).collect(),
        Some("<f4") => {
            data.as_chunks::<4>().0.iter().map(|b| f64::from(f32::from_le_bytes(*b))).collect()
        }
        Some("<i8") => {
            data.as_chunks::<8>().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect()
        }
        Some("<i4") => {
            data.as_chunks::<4>().0.iter().map(|b| f64::from(i32::from_le_bytes(*b))).collect()
        }
        other => return Err(Error::other(format!("dtype {other:?}"))),
    };
    Ok(Array { values })
}
