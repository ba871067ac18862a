//! Models that a client may send: an exercise that can be counted, and numbers that no one should send.

use posed_motion::exercise::{Exercise, Options, Stream, teach};
use posed_stage::input::Model;

use crate::dice::Dice;

/// An exercise taught from a hand that waves to and fro, under one of a few names.
pub(crate) fn wave(sensor: &str, dice: &mut Dice) -> Exercise {
    const RATE_HZ: f64 = 50.0;
    let column = format!("{sensor}_x_m");
    let period_s = dice.range(1.0, 2.5);
    let frames = ((6.0 * period_s + 3.0) * RATE_HZ) as usize;
    let t_s: Vec<f64> = (0..frames).map(|frame| frame as f64 / RATE_HZ).collect();
    let place = |t_s: f64| {
        let phase = (t_s - 1.0) / period_s;
        let share = phase - phase.floor();
        let moves = (0.0..5.0).contains(&phase) && share < 0.8;
        let turn = if moves { share / 0.8 * std::f64::consts::TAU } else { 0.0 };
        0.5 + 0.15 * (1.0 - libm::cos(turn)) + 1e-3 * libm::sin(17.0 * t_s)
    };
    let values: Vec<Option<f64>> = t_s.iter().map(|&t_s| Some(place(t_s))).collect();
    let columns = vec![column.clone()];
    let stream = Stream { columns: &columns, t_s: &t_s, values: &values };
    let name = (*dice.pick(&["wave", "wave", "another", "a third"])).to_owned();
    let options = Options { name, repetitions: 5, channels: Some(columns.clone()), ..Options::default() };
    teach(&stream, &options).expect("five repetitions").exercise
}

/// A model whose numbers may be anything.
pub(crate) fn numbers(dice: &mut Dice, device: &str, sensor: &str) -> Model {
    let mut number = || match dice.below(8) {
        0 => f64::NAN,
        1 => 1e300,
        2 => 0.0,
        3 => -1.0,
        _ => dice.log_range(1e-6, 10.0),
    };
    let vector = [number(), number(), number()];
    let quaternion = [number(), number(), number(), number()];
    match (number() * 1e6) as u64 % 3 {
        0 => Model::Transmitter { position_m: vector, orientation_wxyz: quaternion },
        1 => Model::TrackerNoise {
            device: device.to_owned(),
            r0_m: vector[0],
            sigma_radial_m: vector[1],
            sigma_rotation_rad: vector[2],
        },
        _ => Model::AttachedImu {
            sensor: sensor.to_owned(),
            quat_wxyz: quaternion,
            offset_m: vector,
            clock_offset_s: vector[0],
        },
    }
}
