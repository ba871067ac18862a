//! Metal as secondary sources: image planes (floors, walls) and induced dipoles (objects).

use nalgebra::{Matrix3, SMatrix, Vector3};
use serde::{Deserialize, Serialize};

use super::dipole::{field, field_gradient, solve, solve_closely};

/// What a secondary source of the field stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// A plane: the mirror image of the transmitter. Iron is positive, a conductor negative, both at most one.
    Plane,
    /// A compact object: the dipole induced in it by the transmitter.
    Object,
}

/// One secondary source of the field: 4 parameters. Its moments are in `docs/methods/field.md`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Source {
    /// Plane or object.
    pub kind: Kind,
    /// Centre of an object, or the mirrored transmitter, in the transmitter frame, m.
    pub position_m: [f64; 3],
    /// A plane: the strength of the image, 0 to 1. An object: `q a^3 / 2`, m^3 (sphere of radius a; q = -1 for a
    /// perfect conductor, +2 for iron).
    pub strength: f64,
}

/// Places are found to this, m; in steps no longer than this; and no farther from the reading than this.
const PRECISION_M: f64 = 1e-8;
const LONGEST_STEP_M: f64 = 0.1;
const FARTHEST_M: f64 = 0.5;
/// Who has gone a step farther does not come back: most of those who look from all around a reading beside metal.
const LOST_M: f64 = FARTHEST_M + LONGEST_STEP_M;
/// Steps in which metal is switched on where a place is hard to find.
const FOLLOWING_STEPS: u32 = 8;

/// A place with such a spread of readings around it has no rival that is likelier.
const PLAIN: std::ops::Range<f64> = 0.3..2.0;
/// A place that was found must read so, m.
const READ_M: f64 = 1e-5;
/// How far around a reading its place is looked for, m.
const AROUND_M: [f64; 3] = [0.1, 0.2, 0.35];

/// Parameters of one source: position and strength.
pub(crate) const SOURCE_PARAMETERS: usize = 4;

impl Source {
    fn position(&self) -> Vector3<f64> {
        Vector3::from(self.position_m)
    }

    /// Moments that the three source axes induce at unit strength.
    pub(crate) fn moments(&self) -> Matrix3<f64> {
        let c = self.position();
        match self.kind {
            Kind::Object => field(&c),
            Kind::Plane => c * c.transpose() * (2.0 / c.norm_squared()) - Matrix3::identity(),
        }
    }

    /// Derivatives of [`Source::moments`] by the position.
    fn moments_gradient(&self) -> [Matrix3<f64>; 3] {
        let c = self.position();
        match self.kind {
            Kind::Object => field_gradient(&c),
            Kind::Plane => {
                let r2 = c.norm_squared();
                let outer = c * c.transpose();
                [0, 1, 2].map(|l| {
                    let mut d = outer * (-4.0 * c[l] / (r2 * r2));
                    for k in 0..3 {
                        d[(k, l)] += 2.0 * c[k] / r2;
                        d[(l, k)] += 2.0 * c[k] / r2;
                    }
                    d
                })
            }
        }
    }
}

/// All metal around, ready to be asked: what depends on the sources alone is computed once.
#[derive(Clone, Debug, Default)]
pub(crate) struct Metal {
    sources: Vec<Prepared>,
}

#[derive(Clone, Debug)]
struct Prepared {
    kind: Kind,
    position: Vector3<f64>,
    strength: f64,
    /// Moments at strength one, at full strength, and derivatives of these by the position.
    unit: Matrix3<f64>,
    moments: Matrix3<f64>,
    gradient: [Matrix3<f64>; 3],
}

/// A source relative to a place: its field is `near v' - moments / r^3`, where `near` is `3 from / r^5`.
struct View {
    from: Vector3<f64>,
    near: Vector3<f64>,
    v: Vector3<f64>,
    inverse_r2: f64,
    inverse_r3: f64,
}

impl Prepared {
    fn view(&self, p: &Vector3<f64>) -> View {
        let from = p - self.position;
        let inverse_r2 = 1.0 / from.norm_squared();
        let inverse_r3 = inverse_r2 * inverse_r2.sqrt();
        let near = from * (3.0 * inverse_r3 * inverse_r2);
        View { from, near, v: self.moments.tr_mul(&from), inverse_r2, inverse_r3 }
    }

    /// Adds `share` of the field.
    fn add_field(&self, p: &Vector3<f64>, share: f64, total: &mut Matrix3<f64>) {
        let View { near, v, inverse_r3, .. } = self.view(p);
        let (near, thin) = (near * share, inverse_r3 * share);
        for column in 0..3 {
            for row in 0..3 {
                total[(row, column)] += near[row] * v[column] - self.moments[(row, column)] * thin;
            }
        }
    }

    /// Derivatives of the field by the place.
    fn by_position(&self, view: &View) -> [Matrix3<f64>; 3] {
        let View { from, near, v, inverse_r2, inverse_r3 } = view;
        let steep = 3.0 * inverse_r3 * inverse_r2;
        let mut radial = self.moments * steep;
        for column in 0..3 {
            let v = 5.0 * inverse_r2 * v[column];
            for row in 0..3 {
                radial[(row, column)] -= near[row] * v;
            }
        }
        [0, 1, 2].map(|l| {
            let mut change = radial * from[l];
            for column in 0..3 {
                change[(l, column)] += steep * v[column];
                let moment = self.moments[(l, column)];
                for row in 0..3 {
                    change[(row, column)] += near[row] * moment;
                }
            }
            change
        })
    }
}

/// A place found for a reading.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FoundPosition {
    /// The true position, m.
    pub(crate) p: Vector3<f64>,
    /// Derivative of `p` by the nine numbers of the field at a fixed reading, with the sign of a correction.
    pub(crate) by_field: SMatrix<f64, 3, 9>,
}

impl Metal {
    pub(crate) fn new(sources: &[Source]) -> Self {
        let prepare = |source: &Source| Prepared {
            kind: source.kind,
            position: source.position(),
            strength: source.strength,
            unit: source.moments(),
            moments: source.moments() * source.strength,
            gradient: source.moments_gradient().map(|gradient| gradient * source.strength),
        };
        Self { sources: sources.iter().map(prepare).collect() }
    }

    /// Field of transmitter and metal at `p`.
    pub(crate) fn field(&self, p: &Vector3<f64>) -> Matrix3<f64> {
        self.field_of(p, 1.0)
    }

    /// The same if the metal answers with `share` of its strength.
    fn field_of(&self, p: &Vector3<f64>, share: f64) -> Matrix3<f64> {
        let mut total = field(p);
        self.sources.iter().for_each(|source| source.add_field(p, share, &mut total));
        total
    }

    /// What the device reports for a sensor at `p`.
    pub(crate) fn reading(&self, p: &Vector3<f64>) -> Vector3<f64> {
        solve(&self.field(p), p).position
    }

    /// Derivatives of the field by the place.
    pub(crate) fn gradient(&self, p: &Vector3<f64>, share: f64) -> [Matrix3<f64>; 3] {
        let mut total = field_gradient(p);
        for source in &self.sources {
            for (sum, change) in total.iter_mut().zip(source.by_position(&source.view(p))) {
                *sum += change * share;
            }
        }
        total
    }

    /// The place where the device reports `z`; `None` where there is none near `z`.
    ///
    /// Where metal folds the field the reading itself is too bad a first guess: there the metal is switched on step by
    /// step, and the place is followed.
    pub(crate) fn correct(&self, z: &Vector3<f64>) -> Option<Vector3<f64>> {
        let found = self.correct_from(z, *z, 1.0).or_else(|| {
            (1..=FOLLOWING_STEPS)
                .try_fold(*z, |p, step| self.correct_from(z, p, f64::from(step) / f64::from(FOLLOWING_STEPS)))
        });
        found.filter(|p| (p - z).norm() < FARTHEST_M)
    }

    /// As [`Metal::correct`]. Where that finds nothing, or a place around which space is folded, it looks from `guess`, and
    /// without one from all around the reading. Of several places the likeliest is taken: the one around which the most
    /// places read nearly the same.
    pub(crate) fn find(&self, z: &Vector3<f64>, guess: Option<Vector3<f64>>) -> Option<Vector3<f64>> {
        let plain = self.plain(z);
        if let Some((spread, p)) = plain
            && PLAIN.contains(&spread)
        {
            return Some(p);
        }
        let from = |guess: Vector3<f64>| self.correct_from(z, guess, 1.0).filter(|p| self.reads(p, z));
        let around = AROUND_M.into_iter().flat_map(|far| directions().map(move |way| z + way * far));
        let starts = around.filter(|_| guess.is_none()).chain(guess);
        let others = starts.filter_map(from).map(|p| (self.spread(&p), p));
        plain.into_iter().chain(others).min_by(|a, b| a.0.abs().total_cmp(&b.0.abs())).map(|(_, p)| p)
    }

    /// As [`Metal::find`], where nobody has to look around; `None` where space may be folded.
    pub(crate) fn find_plain(&self, z: &Vector3<f64>) -> Option<Vector3<f64>> {
        self.plain(z).filter(|(spread, _)| PLAIN.contains(spread)).map(|(_, p)| p)
    }

    /// The place that is found first, and the spread of readings around it.
    fn plain(&self, z: &Vector3<f64>) -> Option<(f64, Vector3<f64>)> {
        self.correct(z).filter(|p| self.reads(p, z)).map(|p| (self.spread(&p), p))
    }

    /// Whether a sensor may be at `p`, and reads `z` there.
    fn reads(&self, p: &Vector3<f64>, z: &Vector3<f64>) -> bool {
        (p - z).norm() < FARTHEST_M
            && self.surface(p) > 0.0
            && (solve_closely(&self.field(p), p).position - z).norm() < READ_M
    }

    /// The volume over which readings spread around a place, against the volume of their places; negative where they are
    /// turned inside out.
    fn spread(&self, p: &Vector3<f64>) -> f64 {
        let b = self.field(p);
        self.jacobian(p, &solve(&b, p).derivative(&b), 1.0).determinant()
    }

    /// The place near `guess` where the device reports `z` if the metal answers with `share` of its strength.
    ///
    /// Newton's method with one Jacobian, which Broyden's updates keep true: a field costs a tenth of it.
    fn correct_from(&self, z: &Vector3<f64>, guess: Vector3<f64>, share: f64) -> Option<Vector3<f64>> {
        let mut p = guess;
        let mut inverse = Matrix3::identity();
        let mut last = (Vector3::zeros(), Vector3::zeros());
        for round in 0..24 {
            let b = self.field_of(&p, share);
            let reading = solve(&b, &p);
            let missed = z - reading.position;
            if round % 8 == 1 {
                inverse = self.jacobian(&p, &reading.derivative(&b), share).try_inverse()?;
            } else if round > 1 {
                let (step, before) = last;
                let back = inverse * (before - missed);
                let along = step.dot(&back);
                if along > 0.1 * step.norm_squared() {
                    inverse += (step - back) * (step.transpose() * inverse) / along;
                }
            }
            let mut step = inverse * missed;
            let length = step.norm();
            if !length.is_finite() {
                return None;
            }
            if length > LONGEST_STEP_M {
                step *= LONGEST_STEP_M / length;
            }
            p += step;
            if (p - z).norm_squared() > LOST_M * LOST_M {
                return None;
            }
            last = (step, missed);
            if length < PRECISION_M {
                return Some(p);
            }
        }
        None
    }

    /// As [`Metal::correct`], with what a solver needs.
    pub(crate) fn position(&self, z: &Vector3<f64>) -> Option<FoundPosition> {
        let p = self.correct(z)?;
        let field = self.field(&p);
        let derivative = solve(&field, &p).derivative(&field);
        let inverse = self.jacobian(&p, &derivative, 1.0).try_inverse()?;
        Some(FoundPosition { p, by_field: -inverse * derivative })
    }

    /// Derivative of the reading by the place.
    fn jacobian(&self, p: &Vector3<f64>, derivative: &SMatrix<f64, 3, 9>, share: f64) -> Matrix3<f64> {
        let mut jacobian = Matrix3::zeros();
        for (l, change) in self.gradient(p, share).iter().enumerate() {
            jacobian.set_column(l, &times(derivative, change));
        }
        jacobian
    }

    /// Derivatives of the place by all parameters, source by source: position, then strength.
    pub(crate) fn parameters(&self, position: &FoundPosition, mut each: impl FnMut(usize, Vector3<f64>)) {
        for (index, source) in self.sources.iter().enumerate() {
            let view = source.view(&position.p);
            let View { from, near, inverse_r3, .. } = &view;
            let field_of =
                |moments: &Matrix3<f64>| near * moments.tr_mul(from).transpose() - moments * *inverse_r3;
            for (l, (moved, by_position)) in source.gradient.iter().zip(source.by_position(&view)).enumerate()
            {
                let change = field_of(moved) - by_position;
                each(SOURCE_PARAMETERS * index + l, times(&position.by_field, &change));
            }
            each(SOURCE_PARAMETERS * index + 3, times(&position.by_field, &field_of(&source.unit)));
        }
    }

    /// Distance from `p` to the surface of the nearest object, m: of the smallest sphere of iron (`q = 2`) or conductor
    /// (`q = -1`) that answers so strongly.
    pub(crate) fn surface(&self, p: &Vector3<f64>) -> f64 {
        let objects = self.sources.iter().filter(|source| source.kind == Kind::Object);
        objects
            .map(|source| {
                let s = source.strength;
                (p - source.position).norm() - if s > 0.0 { libm::cbrt(s) } else { libm::cbrt(-2.0 * s) }
            })
            .fold(f64::INFINITY, f64::min)
    }

    /// Distance from `p` to the nearest source, m.
    pub(crate) fn clearance(&self, p: &Vector3<f64>) -> f64 {
        self.sources.iter().map(|source| (p - source.position).norm()).fold(f64::INFINITY, f64::min)
    }
}

/// Along the edges and diagonals of a cube.
fn directions() -> impl Iterator<Item = Vector3<f64>> {
    let ways = (0..27).map(|k| Vector3::from([k % 3, k / 3 % 3, k / 9].map(|n| f64::from(n) - 1.0)));
    ways.filter_map(|way| way.try_normalize(0.5))
}

/// A linear map of a matrix, taken column by column.
pub(crate) fn times(map: &SMatrix<f64, 3, 9>, matrix: &Matrix3<f64>) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    for k in 0..9 {
        sum += map.column(k) * matrix[k];
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sources() -> Vec<Source> {
        vec![
            Source { kind: Kind::Plane, position_m: [0.1, -0.05, -0.8], strength: 0.06 },
            Source { kind: Kind::Object, position_m: [2.2, 1.3, 0.3], strength: -0.004 },
        ]
    }

    #[test]
    fn a_place_is_where_the_device_would_report_the_reading() {
        let metal = Metal::new(&sources());
        for p in [Vector3::new(1.0, 0.2, 0.6), Vector3::new(1.8, -0.7, 1.1), Vector3::new(1.9, 0.9, 0.4)] {
            let z = metal.reading(&p);
            assert!((z - p).norm() > 1e-4, "there is something to correct");
            assert!((metal.position(&z).unwrap().p - p).norm() < 1e-7);
        }
    }

    #[test]
    fn derivatives_by_the_parameters_are_differences() {
        let sources = sources();
        let z = Vector3::new(1.7, 0.6, 0.5);
        let metal = Metal::new(&sources);
        let position = metal.position(&z).unwrap();
        let mut derivatives = [Vector3::zeros(); 8];
        metal.parameters(&position, |k, d| derivatives[k] = d);
        for (k, derivative) in derivatives.iter().enumerate() {
            let h = if k % 4 == 3 { 1e-6 } else { 1e-5 };
            let moved = |sign: f64| {
                let mut moved = sources.clone();
                let source = &mut moved[k / 4];
                match k % 4 {
                    3 => source.strength += sign * h,
                    l => source.position_m[l] += sign * h,
                }
                Metal::new(&moved).position(&z).unwrap().p
            };
            let difference = (moved(1.0) - moved(-1.0)) / (2.0 * h);
            assert!(
                (derivative - difference).norm() < 1e-5 * (1.0 + difference.norm()),
                "{k} {derivative} {difference}"
            );
        }
    }
}
