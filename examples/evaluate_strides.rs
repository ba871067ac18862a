//! How well strides are counted: `cargo run --release --example evaluate_strides -- FOLDER [CHANNELS]`.
//!
//! FOLDER holds walking trials with a sensor on each foot (`events.csv` and one `.csv.gz` per trial, cells of lost packets empty).
//! Each trial's foot is taught once, from the whole trial with its number of swings, and counted on the same foot
//! of all other people (`others`), and on itself (`own`: whether a lesson knows its own strides). Each is also taught from its own way there
//! and counted on the turn and the way back, and the other way round (`halves`): nothing that is counted was taught. CHANNELS are the axes (`gy`; without it the three sets of the document: `gy`, `gx,gy,gz` and
//! `ax,ay,az,gx,gy,gz`, of which teaching chooses). One line per trial that is taught, three summaries per set of channels.
//!
//! Marks outside the walk (`trial`) are left out. A stride is found when a repetition ends within half a stride of the end of its swing; each repetition finds one.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write;
use std::path::Path;

use posed_motion::exercise::{Counter, EventKind, Exercise, Options, Stream, teach};
use posed_recording::table::{Streams, TableReader};

const RATE_HZ: f64 = 100.0;
const SETS: [&str; 3] = ["gy", "gx,gy,gz", "ax,ay,az,gx,gy,gz"];

/// One foot in one trial.
struct Foot {
    name: String,
    /// Whose trial it is.
    person: String,
    /// `lf` or `rf`.
    side: &'static str,
    streams: Streams,
    /// Ends of the swings, s.
    swings_s: Vec<f64>,
    /// Beginning and end of the turn, s.
    turn_s: [f64; 2],
}

#[derive(Default)]
struct Score {
    trials: usize,
    exact: usize,
    within_one: usize,
    strides: usize,
    found: usize,
    counted: usize,
    refused: usize,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("give the folder with events.csv")?;
    let feet = read(Path::new(&folder))?;
    let mut out = std::io::stdout().lock();
    let named: Vec<String> = arguments.collect();
    let sets = if named.is_empty() { SETS.map(str::to_owned).to_vec() } else { named };
    for set in sets {
        let axes: Vec<&str> = set.split(',').collect();
        let (mut others, mut own, mut halves) = (Score::default(), Score::default(), Score::default());
        for teacher in &feet {
            teach_one(teacher, &feet, &axes, [&mut others, &mut own], &mut out)?;
        }
        for foot in &feet {
            teach_half(foot, &axes, &mut halves, &mut out)?;
        }
        for (name, score) in [("others", &others), ("own", &own), ("halves", &halves)] {
            writeln!(out, "{set}, {name}: {}", score.line())?;
        }
    }
    Ok(())
}

/// Teaches one foot and counts that side of everybody.
fn teach_one(
    teacher: &Foot,
    feet: &[Foot],
    axes: &[&str],
    [others, own]: [&mut Score; 2],
    out: &mut impl Write,
) -> Result<(), Box<dyn Error>> {
    let streams = teacher.only(axes)?;
    let options =
        Options { name: "stride".into(), repetitions: teacher.swings_s.len(), ..Options::default() };
    let lesson = match teach(&stream(&streams), &options) {
        Ok(lesson) => {
            let saw = lesson.report.repetitions.len();
            let channels = lesson.exercise.channels.join(" ");
            write!(out, "{} saw {saw} of {} in {channels}:", teacher.name, options.repetitions)?;
            Some(lesson)
        }
        Err(refusal) => {
            write!(out, "{} refused: {refusal}", teacher.name)?;
            others.refused += 1;
            own.refused += 1;
            None
        }
    };
    for foot in feet.iter().filter(|foot| foot.side == teacher.side) {
        let ends_s = match &lesson {
            Some(lesson) => ends_s(&lesson.exercise, &stream(&foot.only(axes)?))?,
            None => Vec::new(),
        };
        let found = found(&foot.swings_s, &ends_s);
        write!(
            out,
            " {}{:+}({}/{})",
            foot.name,
            ends_s.len() as i64 - foot.swings_s.len() as i64,
            found,
            foot.swings_s.len()
        )?;
        let score = if foot.person == teacher.person { &mut *own } else { &mut *others };
        score.add(foot.swings_s.len(), found, ends_s.len());
    }
    writeln!(out)?;
    Ok(())
}

/// Teaches one way of a foot and counts the other one, with the turn.
fn teach_half(
    foot: &Foot,
    axes: &[&str],
    score: &mut Score,
    out: &mut impl Write,
) -> Result<(), Box<dyn Error>> {
    let streams = foot.only(axes)?;
    let [turn_s, back_s] = foot.turn_s;
    let ways = [([0.0, turn_s], [turn_s, f64::INFINITY]), ([back_s, f64::INFINITY], [0.0, back_s])];
    for (taught, counted) in ways {
        let swings = |[from_s, to_s]: [f64; 2]| -> Vec<f64> {
            foot.swings_s.iter().copied().filter(|end_s| (from_s..to_s).contains(end_s)).collect()
        };
        let repetitions = swings(taught).len();
        let options = Options { name: "stride".into(), repetitions, ..Options::default() };
        let lesson = teach(&stream(&streams).between(taught[0], taught[1]), &options);
        let ends_s = match &lesson {
            Ok(lesson) => {
                let saw = lesson.report.repetitions.len();
                let channels = lesson.exercise.channels.join(" ");
                write!(out, "{} half saw {saw} of {repetitions} in {channels}:", foot.name)?;
                let all = self::stream(&streams);
                ends_s(&lesson.exercise, &all.between(counted[0], counted[1]))?
            }
            Err(refusal) => {
                write!(out, "{} half refused: {refusal}", foot.name)?;
                score.refused += 1;
                Vec::new()
            }
        };
        let swings_s = swings(counted);
        let found = found(&swings_s, &ends_s);
        writeln!(out, " {:+}({found}/{})", ends_s.len() as i64 - swings_s.len() as i64, swings_s.len())?;
        score.add(swings_s.len(), found, ends_s.len());
    }
    Ok(())
}

impl Foot {
    /// Its stream of these axes.
    fn only(&self, axes: &[&str]) -> Result<Streams, Box<dyn Error>> {
        let streams = &self.streams;
        let columns: Vec<usize> = axes
            .iter()
            .map(|axis| {
                let place = streams.columns.iter().position(|column| column == axis);
                place.ok_or_else(|| format!("there is no axis {axis}"))
            })
            .collect::<Result<_, _>>()?;
        let rows = streams.values.chunks_exact(streams.columns.len());
        Ok(Streams {
            columns: axes.iter().map(|axis| (*axis).to_owned()).collect(),
            t_s: streams.t_s.clone(),
            values: rows.flat_map(|row| columns.iter().map(|column| row[*column])).collect(),
        })
    }
}

/// How many swings one of the repetitions ends within half a stride of, each repetition used once.
fn found(swings_s: &[f64], ends_s: &[f64]) -> usize {
    let mut lengths: Vec<f64> = swings_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    lengths.sort_by(f64::total_cmp);
    let half_s = 0.5 * lengths.get(lengths.len() / 2).copied().unwrap_or(1.0);
    let mut rest = ends_s.iter().peekable();
    let mut found = 0;
    for swing_s in swings_s {
        while rest.next_if(|end_s| **end_s < swing_s - half_s).is_some() {}
        found += usize::from(rest.next_if(|end_s| **end_s <= swing_s + half_s).is_some());
    }
    found
}

impl Score {
    fn add(&mut self, strides: usize, found: usize, counted: usize) {
        self.trials += 1;
        self.exact += usize::from(strides == counted);
        self.within_one += usize::from(strides.abs_diff(counted) <= 1);
        self.strides += strides;
        self.found += found;
        self.counted += counted;
    }

    fn line(&self) -> String {
        let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
        let Self { trials, exact, within_one, strides, found, counted, refused } = *self;
        format!(
            "{trials} trials, exact {:.1} %, within one {:.1} %; {:.1} % of {strides} strides found; {:.1} % of {counted} \
             counts false; {refused} of the demonstrations refused",
            percent(exact, trials),
            percent(within_one, trials),
            percent(found, strides),
            percent(counted - found, counted)
        )
    }
}

/// Ends of the repetitions that are counted, s.
fn ends_s(exercise: &Exercise, stream: &Stream<'_>) -> Result<Vec<f64>, Box<dyn Error>> {
    let mut counter = Counter::new(vec![exercise.clone()], stream.columns)?;
    let mut ends_s = Vec::new();
    let mut note = |event: posed_motion::exercise::Event| {
        if event.kind == EventKind::Counted {
            ends_s.push(event.t_s);
        }
    };
    for (t_s, row) in stream.t_s.iter().zip(stream.values.chunks_exact(stream.columns.len())) {
        counter.push(*t_s, row, &mut note);
    }
    counter.finish(&mut note);
    Ok(ends_s)
}

fn stream(streams: &Streams) -> Stream<'_> {
    Stream { columns: &streams.columns, t_s: &streams.t_s, values: &streams.values }
}

/// Both feet of every trial.
fn read(folder: &Path) -> Result<Vec<Foot>, Box<dyn Error>> {
    let mut table = TableReader::open(&folder.join("events.csv"))?;
    let [trial, event, from, to] = table.require(["trial", "event", "from", "to"])?;
    let mut begins: BTreeMap<(String, String), Vec<f64>> = BTreeMap::new();
    let mut events: BTreeMap<(String, String), Vec<f64>> = BTreeMap::new();
    while table.next_row()? {
        let key = (table.text(trial).to_owned(), table.text(event).to_owned());
        begins.entry(key.clone()).or_default().push(table.required_number(from)? / RATE_HZ);
        events.entry(key).or_default().push(table.required_number(to)? / RATE_HZ);
    }
    let mut feet = Vec::new();
    for ((trial, event), mut swings_s) in events.clone() {
        let side = match event.as_str() {
            "left_foot" => "lf",
            "right_foot" => "rf",
            _ => continue,
        };
        let walk = events.get(&(trial.clone(), "trial".to_owned()));
        let end_s = walk.and_then(|ends_s| ends_s.first()).copied().unwrap_or(f64::INFINITY);
        swings_s.retain(|swing_s| *swing_s <= end_s);
        let turn = |of: &BTreeMap<(String, String), Vec<f64>>| {
            of.get(&(trial.clone(), "uturn".to_owned())).and_then(|times_s| times_s.first()).copied()
        };
        let turn_s = [turn(&begins).unwrap_or(end_s), turn(&events).unwrap_or(end_s)];
        let columns: Vec<String> =
            ["ax", "ay", "az", "gx", "gy", "gz"].map(|axis| format!("{side}_{axis}")).to_vec();
        let path = folder.join(format!("{trial}.csv.gz"));
        let mut streams = Streams::read(&path, Some(&columns), Some(RATE_HZ))?;
        for column in &mut streams.columns {
            column.drain(..3);
        }
        let person = trial.split('-').next().unwrap_or(&trial).to_owned();
        feet.push(Foot { name: format!("{trial}{side}"), person, side, streams, swings_s, turn_s });
    }
    Ok(feet)
}
