//! `posed field solve`.

use std::path::{Path, PathBuf};

use indicatif::{ProgressBar, ProgressStyle};
use nalgebra::Vector3;
use posed_field::{Anchor, PoleReading, PoleRun, Rejected, Report, solve, solve_limbs};
use posed_geometry::orientation_from_wxyz;
use posed_recording::is_recording;
use posed_recording::table::{Poses, TableReader, TableWriter};
use posed_stage::Stage;

use super::correct::Correction;
use super::{Error, cascade, collect, limbs, notify, output, print, print_json};

/// A recording of the pole, and what is known of it.
#[derive(clap::Args)]
#[command(
    after_help = "Examples:\n  posed field solve pole.csv --spacing-m 0.3 --anchors anchors.csv -o field.json\n  \
    posed field solve session.mcap --body stage.toml -o field.json --corrected session.csv\n  \
    posed field solve session.mcap --body stage.toml --n-pose 0,3 -o field.json\n  \
    posed field solve pole.csv --spacing-m 0.3 --method cascade -o cascade.json --picture cascade.svg\n\n\
    POLE: poses (t,sensor,x,y,z and, for orientations, qw,qx,qy,qz) in the transmitter frame; the order of first \
    appearance is the order along the pole. Of a recording it takes what the devices said.\n\
    Anchors: name,sensor,t_start,t_end,x,y,z."
)]
pub(crate) struct Args {
    /// Poses of the pole's sensors, or of those that a person wears: `.csv`, `.csv.gz` or a recording.
    pole: PathBuf,
    /// Measured distance between neighbouring sensors, m; never estimated.
    #[arg(long, value_name = "D", required_unless_present = "body")]
    spacing_m: Option<f64>,
    /// The pole's sensors in their order along it, where a recording holds others too.
    #[arg(long, value_name = "A,B,C", value_delimiter = ',', conflicts_with = "body")]
    sensors: Vec<String>,
    /// Instead of a pole: the stage file whose [body] wears the sensors.
    #[arg(long, value_name = "STAGE.toml", conflicts_with = "spacing_m")]
    body: Option<PathBuf>,
    /// A measured bone, joint to joint, in place of the body's height; may be repeated.
    #[arg(long, value_name = "SEGMENT=M", value_parser = super::limbs::measured, requires = "body")]
    bone: Vec<super::limbs::Measured>,
    /// When in the session the person stood in an N-pose, arms hanging, looking ahead, s: looks for joints where that puts them, too, and leaves out what
    /// no joint allows. Needs `height_m`, and sensors on both sides.
    #[arg(long, value_name = "FROM,TO", value_parser = super::limbs::span, requires = "body")]
    n_pose: Option<[f64; 2]>,
    /// Surveyed points that a sensor stood on: three or more make positions absolute.
    #[arg(long, value_name = "CSV", conflicts_with = "body")]
    anchors: Option<PathBuf>,
    /// Write the session corrected, as `posed field correct` does.
    #[arg(long, value_name = "CSV")]
    corrected: Option<PathBuf>,
    /// Where to write the map; nothing is written when it is refused.
    #[arg(short, long, value_name = "FIELD.json")]
    output: PathBuf,
    /// Where to write the readings that were not believed: t,sensor,reason.
    #[arg(long, value_name = "CSV")]
    rejected: Option<PathBuf>,
    /// `joint`: all readings at once; `cascade`: a filter and a network in turn, as Piperakis et al. (about 2005), for comparison.
    #[arg(long, value_enum, default_value = "joint")]
    method: Method,
    /// Print the report as one JSON object: accepted, reasons, warnings, residual_m, heldout_m, anchors_m and more; of the cascade
    /// filter, residuals_m, steps_m, readings, rejected and pairs.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    cascade: cascade::Published,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum Method {
    Joint,
    Cascade,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let is_cascade = args.method == Method::Cascade;
    if is_cascade && (args.body.is_some() || args.anchors.is_some() || args.rejected.is_some()) {
        return Err(Error::Usage("--method cascade takes a pole, without --anchors and --rejected".into()));
    }
    if !is_cascade && args.cascade.is_asked_for() {
        return Err(Error::Usage(
            "--filter, --rounds, --grid-m, --trajectories and --picture belong to --method cascade".into(),
        ));
    }
    if let Some(spacing_m) = args.spacing_m
        && !(spacing_m.is_finite() && spacing_m > 0.0)
    {
        return Err(Error::Usage(format!("--spacing-m must be a length above 0, not {spacing_m}")));
    }
    let body = args.body.as_deref().map(|path| {
        let stage = Stage::load(path).map_err(Error::failed)?;
        let one = |reason| Error::Failed(format!("{}: {reason} in a file of its own", path.display()));
        let stage = stage.of_body(None).map_err(one)?;
        let (names, limbs) = limbs::of_stage(&stage, &args.bone)?;
        Ok((stage, names, limbs))
    });
    let mut body = body.transpose()?;
    let named = body.as_ref().map_or(args.sensors.as_slice(), |(_, names, _)| names);
    // A body has no spacing; nobody looks at this one.
    let run = read_run(&args.pole, named, args.spacing_m.unwrap_or(1.0))?;
    if let (Some((stage, _, limbs)), Some(span_s)) = (&mut body, args.n_pose) {
        limbs::add_posture(limbs, &run, stage, span_s)?;
    }
    if body.is_none() {
        run.check_order().map_err(|error| Error::Failed(format!("{}: {error}", args.pole.display())))?;
    }
    if is_cascade {
        let network = cascade::run(&run, &args.cascade, &args.output, args.json)?;
        if let Some(path) = &args.corrected {
            super::correct::write_corrected(&Correction::Cascade(network), &args.pole, path)?;
        }
        return Ok(());
    }
    let anchors = match &args.anchors {
        Some(path) => read_anchors(path, &run.sensors)?,
        None => Vec::new(),
    };
    let bar = ProgressBar::new(1000);
    if let Ok(style) = ProgressStyle::with_template("solving {bar:40} {percent:>3} %  {elapsed}") {
        bar.set_style(style);
    }
    let sensors = run.sensors.clone();
    let mut progress = |share| bar.set_position((1000.0 * share) as u64);
    let solution = match &body {
        Some((_, _, limbs)) => solve_limbs(run, limbs, &mut progress),
        None => solve(run, &anchors, &mut progress),
    };
    bar.finish_and_clear();
    if let Some(path) = &args.rejected {
        write_rejected(path, &sensors, &solution.rejected)?;
    }
    let report = &solution.report;
    if let (true, Some(map)) = (report.accepted, &solution.map) {
        output::replace(&args.output, |file| {
            serde_json::to_writer(&mut *file, map)?;
            file.write_all(b"\n")
        })?;
    }
    if let (true, Some(map), Some(path)) = (report.accepted, &solution.map, &args.corrected) {
        super::correct::write_corrected(&Correction::Map(map.corrector().into()), &args.pole, path)?;
    }
    if args.json {
        print_json(report)?;
    } else {
        print(&sentences(report))?;
        if report.accepted {
            notify(&format!("wrote {}", args.output.display()));
        }
    }
    if report.accepted { Ok(()) } else { Err(Error::Reported) }
}

/// The readings of `sensors` (all, if none are named): of a table grouped by time, of a recording as live.
fn read_run(path: &Path, sensors: &[String], spacing_m: f64) -> Result<PoleRun, Error> {
    if is_recording(path) {
        return collect::run(path, sensors, spacing_m);
    }
    let poses = Poses::read(path).map_err(Error::failed)?;
    let names = if sensors.is_empty() { poses.sensors.clone() } else { sensors.to_vec() };
    if let Some(name) = names.iter().find(|name| !poses.sensors.contains(name)) {
        return Err(Error::Failed(format!("{} has no sensor {name:?}", path.display())));
    }
    let index: Vec<Option<usize>> =
        poses.sensors.iter().map(|name| names.iter().position(|known| known == name)).collect();
    let rows = poses.rows.iter().filter_map(|row| {
        let reading = PoleReading {
            position_m: Vector3::from(row.position_m?),
            orientation: row.orientation_wxyz.and_then(orientation_from_wxyz),
        };
        Some((row.t_s, index[row.sensor]?, reading))
    });
    PoleRun::grouped(names, spacing_m, rows)
        .map_err(|error| Error::Failed(format!("{}: {error}", path.display())))
}

/// The report for a person.
fn sentences(report: &Report) -> String {
    let mut text = format!(
        "{}: {}\n  residual {:.2} mm, held out {:.2} mm, without correction {:.2} mm, noise alone {:.2} mm\n",
        if report.accepted { "accepted" } else { "refused" },
        report.model,
        1e3 * report.residual_m,
        1e3 * report.heldout_m,
        1e3 * report.raw_m,
        1e3 * report.noise_m
    );
    if let Some(anchors_m) = report.anchors_m {
        text += &format!("  at the anchors {:.2} mm\n", 1e3 * anchors_m);
    }
    text += &format!(
        "  {} readings, {} of them not believed\n",
        report.readings + report.rejected,
        report.rejected
    );
    for reason in &report.reasons {
        text += &format!("  refused: {}\n", reason.text);
    }
    for warning in &report.warnings {
        text += &format!("  note: {warning}\n");
    }
    text
}

fn read_anchors(path: &Path, sensors: &[String]) -> Result<Vec<Anchor>, Error> {
    let mut table = TableReader::open(path).map_err(Error::failed)?;
    let [name, sensor, start, end, x, y, z] =
        table.require(["name", "sensor", "t_start", "t_end", "x", "y", "z"]).map_err(Error::failed)?;
    let mut anchors = Vec::new();
    while table.next_row().map_err(Error::failed)? {
        let index = sensors.iter().position(|known| known == table.text(sensor)).ok_or_else(|| {
            Error::failed(table.cell_error(sensor, &format!("a sensor of the pole ({})", sensors.join(", "))))
        })?;
        let t_s = [
            table.required_number(start).map_err(Error::failed)?,
            table.required_number(end).map_err(Error::failed)?,
        ];
        if t_s[1] < t_s[0] {
            return Err(Error::failed(table.cell_error(end, "a time not before t_start")));
        }
        let position = table.vector([x, y, z]).map_err(Error::failed)?;
        let position = position.ok_or_else(|| Error::failed(table.cell_error(x, "the surveyed position")))?;
        anchors.push(Anchor {
            name: table.text(name).to_owned(),
            sensor: index,
            t_s,
            position_m: Vector3::from(position),
        });
    }
    Ok(anchors)
}

fn write_rejected(path: &Path, sensors: &[String], rejected: &[Rejected]) -> Result<(), Error> {
    let write = || {
        let mut table = TableWriter::create(path, &["t", "sensor", "reason"])?;
        for row in rejected {
            table.number(row.t_s)?;
            table.text(&sensors[row.sensor])?;
            table.text(row.reason.name())?;
            table.end_row()?;
        }
        table.finish()
    };
    write().map_err(Error::failed)
}
