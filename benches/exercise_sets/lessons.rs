//! How demonstrations are read by our way and by steps of Weber et al. 2011 as published.

use std::io::Write;

use posed_motion::exercise::AsPublished;
use posed_simulator::exercises::Person;

use super::{PEOPLE, demonstrated};

const OURS: AsPublished = AsPublished { kth_neighbour: false, per_channel: false };
const WAYS: [(&str, AsPublished); 4] = [
    ("ours", OURS),
    ("k-th neighbour", AsPublished { kth_neighbour: true, ..OURS }),
    ("per channel", AsPublished { per_channel: true, ..OURS }),
    ("both as published", AsPublished { kth_neighbour: true, per_channel: true }),
];

/// Sets of five repetitions of all exercises and people: how many are refused, and how far borders of repetitions are off.
pub(super) fn compare(first: u64, out: &mut impl Write) -> std::io::Result<()> {
    for (name, as_published) in WAYS {
        let (mut demonstrations, mut refused, mut off) = (0, 0, Vec::new());
        for seed in first..first + PEOPLE {
            for (recording, lesson) in demonstrated(&Person::new(seed), as_published) {
                demonstrations += 1;
                let Some(lesson) = lesson else {
                    refused += 1;
                    continue;
                };
                for (seen, [start_s, end_s]) in lesson.report.repetitions.iter().zip(&recording.repetitions) {
                    let worst = (seen.t_start_s - start_s).abs().max((seen.t_end_s - end_s).abs());
                    off.push(worst / (end_s - start_s));
                }
            }
        }
        off.sort_by(f64::total_cmp);
        let at = |share: f64| off.get((share * off.len() as f64) as usize).copied().unwrap_or(f64::NAN);
        writeln!(
            out,
            "taught, {name}: {refused} of {demonstrations} demonstrations refused; the worse border of a repetition is off by {:.2} \
             of it at the median, 95 %: {:.2}",
            at(0.5),
            at(0.95)
        )?;
    }
    Ok(())
}
