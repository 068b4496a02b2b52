//! Detectors in the axes of turned library cells.

use super::{CentreOfMass, Detector};

impl Detector {
    /// Whether an image does not change when specimen and probe are turned together.
    pub(crate) fn is_round(&self) -> bool {
        self.sector_degrees.is_none()
            && matches!(self.centre_of_mass, None | Some(CentreOfMass::Electrons))
    }

    /// The detector as seen from a frame, whose rows rotate directions of the frame into directions of the detector.
    #[must_use]
    pub(crate) fn seen_from(&self, frame: [[f64; 2]; 2]) -> Self {
        let [[a, b], [c, d]] = frame;
        let turn = libm::atan2(c, a).to_degrees();
        // An azimuth p is seen at p - turn, or mirrored at turn - p.
        let turned = |[from, to]: [f64; 2]| match a * d - b * c > 0.0 {
            true => [from - turn, to - turn],
            false => [turn - to, turn - from],
        };
        Detector {
            sector_degrees: self.sector_degrees.map(turned),
            centre_of_mass: self.centre_of_mass.map(|part| part.seen_from(frame)),
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sectors_turn_and_are_mirrored() {
        let sector = &Detector::new("S", 10.0, 20.0).divided(4, 20.0)[0];
        let seen = |frame| sector.seen_from(frame).sector_degrees.unwrap();
        assert_eq!(seen([[1.0, 0.0], [0.0, 1.0]]), [20.0, 110.0]);
        // The x axis of the frame points along +y of the field, at 90 degrees.
        assert_eq!(seen([[0.0, -1.0], [1.0, 0.0]]), [-70.0, 20.0]);
        assert_eq!(seen([[1.0, 0.0], [0.0, -1.0]]), [-110.0, -20.0]);
        assert!(!sector.is_round() && Detector::new("A", 1.0, 2.0).is_round());
    }
}
