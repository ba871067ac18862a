//! Angles as the database has them: hundredths of a degree in 16 bits.

use super::StoreError;

/// An angle; what is beyond 16 bits (327 degrees) is at their end.
pub(super) fn hundredths(angle_deg: f64) -> i16 {
    (angle_deg * 100.0).round() as i16
}

/// The angle again.
pub(super) fn degrees(hundredths: i16) -> f64 {
    crate::number::degrees(f64::from(hundredths) / 100.0)
}

/// A course.
pub(super) fn bytes(course_deg: &[f64]) -> Vec<u8> {
    course_deg.iter().flat_map(|angle| hundredths(*angle).to_le_bytes()).collect()
}

/// The course again.
pub(super) fn course(bytes: &[u8]) -> Result<Vec<f64>, StoreError> {
    let (pairs, []) = bytes.as_chunks::<2>() else {
        return Err(StoreError::Damaged("a course has an odd number of bytes".to_owned()));
    };
    Ok(pairs.iter().map(|pair| degrees(i16::from_le_bytes(*pair))).collect())
}
