//! What the body's filters cost: one AHRS sample, one limb update (prediction and both IMUs, 14 rows), and a
//! whole body of ten IMUs. `cargo bench --bench fusion`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{SVector, UnitQuaternion, Vector3};
use posed_fusion::ahrs::{Ahrs, ImuSample, Params};
use posed_fusion::limb::{Arm, Axes, Ball, Base, FieldReference, Leg, LimbGeometry, LimbNoise, LimbSamples};
use posed_geometry::GRAVITY_M_S2;

fn sample(t: f64) -> ImuSample {
    ImuSample {
        gyro_rad_s: Vector3::new(libm::sin(2.1 * t), libm::cos(1.3 * t), libm::sin(0.9 * t)),
        accel_m_s2: Vector3::new(libm::sin(5.0 * t), -GRAVITY_M_S2, libm::cos(6.1 * t)),
        mag: Some(Vector3::new(17.0, 42.0, 5.0)),
    }
}

fn geometry() -> LimbGeometry {
    LimbGeometry {
        mount_sigma_rad: [Vector3::zeros(); 2],
        base_to_joint_m: Vector3::new(0.0, 0.4, 0.18),
        upper_imu_m: Vector3::new(0.03, -0.15, 0.04),
        upper_to_lower_m: Vector3::new(0.0, -0.3, 0.0),
        lower_imu_m: Vector3::new(0.02, -0.2, 0.03),
        upper_mount: UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.2, 0.5)),
        lower_mount: UnitQuaternion::from_scaled_axis(Vector3::new(-0.4, 0.6, 0.1)),
    }
}

fn ball() -> Ball {
    Ball {
        q: UnitQuaternion::identity(),
        angular_velocity_rad_s: Vector3::zeros(),
        accel_rad_s2: Vector3::zeros(),
    }
}

fn arm() -> Arm {
    let limits = [SVector::<f64, 2>::repeat(-2.0), SVector::<f64, 2>::repeat(3.0)];
    Arm::new(geometry(), LimbNoise::default(), ball(), Axes::new([Vector3::z(), Vector3::y()]), limits, 0.1)
}

fn leg() -> Leg {
    let limits = [SVector::<f64, 1>::repeat(-3.0), SVector::<f64, 1>::repeat(3.0)];
    Leg::new(geometry(), LimbNoise::default(), ball(), Axes::new([Vector3::z()]), limits, 0.1)
}

/// A limb that hangs still: gyro, accelerometer and azimuth of both IMUs are believed, so all 14 rows are used.
fn still(field: Vector3<f64>) -> LimbSamples {
    let g = geometry();
    let sample = |mount: UnitQuaternion<f64>| {
        Some(ImuSample {
            gyro_rad_s: Vector3::zeros(),
            accel_m_s2: mount.inverse() * Vector3::z() * GRAVITY_M_S2,
            mag: Some(mount.inverse() * field),
        })
    };
    LimbSamples { upper: sample(g.upper_mount), lower: sample(g.lower_mount) }
}

fn benches(c: &mut Criterion) {
    c.bench_function("ahrs/sample at 286 Hz", |b| {
        let mut ahrs = Ahrs::new(Params::default());
        let mut t = 0.0;
        b.iter(|| {
            t += 0.0035;
            ahrs.push(black_box(&sample(t)), 0.0035)
        });
    });
    let base = Base::room();
    let north = Vector3::new(0.0, 17.0, -42.0);
    let field = FieldReference {
        azimuth_rad: std::f64::consts::FRAC_PI_2,
        norm: north.norm(),
        dip_rad: libm::atan(42.0_f64 / 17.0),
    };
    let samples = still(north);
    c.bench_function("limb/arm update", |b| {
        let mut arm = arm();
        b.iter(|| arm.push(black_box(&base), Some(&field), black_box(&samples), 0.01));
    });
    c.bench_function("limb/leg update", |b| {
        let mut leg = leg();
        b.iter(|| leg.push(black_box(&base), Some(&field), black_box(&samples), 0.01));
    });
    c.bench_function("body/10 IMUs", |b| {
        let mut trunk = [Ahrs::new(Params::default()), Ahrs::new(Params::default())];
        let (mut arms, mut legs) = ([arm(), arm()], [leg(), leg()]);
        b.iter(|| {
            for ahrs in &mut trunk {
                black_box(ahrs.push(black_box(&sample(0.0)), 0.01));
            }
            for arm in &mut arms {
                black_box(arm.push(black_box(&base), Some(&field), black_box(&samples), 0.01));
            }
            for leg in &mut legs {
                black_box(leg.push(black_box(&base), Some(&field), black_box(&samples), 0.01));
            }
        });
    });
}

criterion_group!(fusion, benches);
criterion_main!(fusion);
