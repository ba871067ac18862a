//! `posed field solve --method cascade`: the published calibration, and the file that it makes.

use std::path::{Path, PathBuf};

use nalgebra::Vector3;
use posed_baselines::cascade::{Cascade, DistortionNetwork, Filter, Options, cascade};
use posed_field::PoleRun;
use posed_recording::table::{TableError, TableWriter};
use serde::{Deserialize, Serialize};

use super::super::number::within;
use super::{Error, notify, output, print, print_json};
use crate::pictures;

/// After so many rounds the network changes by little.
const ROUNDS: u8 = 8;

/// How the published method is run.
#[derive(clap::Args)]
#[command(next_help_heading = "With --method cascade")]
pub(super) struct Published {
    /// What follows the pole: the paper's thirteen states with the step of its quaternion as printed or put right, or the ten that a
    /// pole shows, with a smoother.
    #[arg(long, value_enum, value_name = "FILTER", default_value = "reduced")]
    filter: FilterName,
    /// How often filter and network take turns.
    #[arg(long, value_name = "N", default_value_t = ROUNDS, value_parser = clap::value_parser!(u8).range(1..=50))]
    rounds: u8,
    /// Spacing of a grid on which the filtered positions are interpolated before the network learns them, m.
    #[arg(long, value_name = "M", value_parser = within(0.01..=1.0, "between 0.01 and 1 m"))]
    grid_m: Option<f64>,
    /// Where to write each sensor as it was measured, filtered and corrected:
    /// t,sensor,x,y,z,filtered_x,...,corrected_x,...
    #[arg(long, value_name = "CSV")]
    trajectories: Option<PathBuf>,
    /// Where to draw how the filter converged, and the trajectories.
    #[arg(long, value_name = "SVG")]
    picture: Option<PathBuf>,
}

#[derive(Clone, Copy, PartialEq, clap::ValueEnum)]
enum FilterName {
    Printed,
    Repaired,
    Reduced,
}

impl Published {
    /// Whether something is asked for that the joint solver does not do.
    pub(super) fn is_asked_for(&self) -> bool {
        self.filter != FilterName::Reduced
            || self.rounds != ROUNDS
            || self.grid_m.is_some()
            || self.trajectories.is_some()
            || self.picture.is_some()
    }
}

/// What the command writes, and `posed field correct` reads.
#[derive(Deserialize, Serialize)]
pub(super) struct File {
    /// From measured to corrected positions, transmitter frame.
    pub(super) cascade: DistortionNetwork,
    report: Report,
}

/// The figures of a run.
#[derive(Clone, Deserialize, Serialize)]
struct Report {
    filter: String,
    /// Rms distance of network and filter after each round: the paper's measure, no error against the truth.
    residuals_m: Vec<f64>,
    /// Mean step of each iteration of the filter, before anything is corrected: Fig. 5.
    steps_m: Vec<f64>,
    readings: usize,
    rejected: usize,
    /// What the network learnt from: readings, or nodes of the grid.
    pairs: usize,
}

/// Calibrates by a recording of the pole, and writes what was asked for.
pub(super) fn run(
    run: &PoleRun,
    args: &Published,
    to: &Path,
    json: bool,
) -> Result<DistortionNetwork, Error> {
    let filter = match args.filter {
        FilterName::Printed => Filter::Printed,
        FilterName::Repaired => Filter::Repaired,
        FilterName::Reduced => Filter::Reduced,
    };
    let options = Options { filter, rounds: args.rounds.into(), grid_m: args.grid_m };
    let solved = cascade(run, &options)
        .ok_or_else(|| Error::Failed("no frame, or no node of the grid, has enough readings".into()))?;
    let count = |run: &PoleRun| run.frames.iter().flat_map(|frame| &frame.readings).flatten().count();
    let report = Report {
        filter: format!("{filter:?}").to_lowercase(),
        residuals_m: solved.residuals_m.clone(),
        steps_m: solved.track.steps.mean_m().to_vec(),
        readings: count(&solved.run),
        rejected: count(run) - count(&solved.run),
        pairs: solved.pairs,
    };
    let file = File { cascade: solved.network.clone(), report: report.clone() };
    output::replace(to, |out| {
        serde_json::to_writer(&mut *out, &file)?;
        out.write_all(b"\n")
    })?;
    if let Some(path) = &args.trajectories {
        write_trajectories(path, &solved).map_err(Error::failed)?;
    }
    if let Some(path) = &args.picture {
        output::replace(path, |out| out.write_all(pictures::cascade::draw(&solved).as_bytes()))?;
    }
    if json {
        print_json(&report)?;
    } else {
        let [first, last] = [report.residuals_m.first(), report.residuals_m.last()]
            .map(|m| 1e3 * m.copied().unwrap_or(f64::NAN));
        print(&format!(
            "network and filter differ by {last:.2} mm ({first:.2} mm in the first round); that is no error against the truth\n  \
             {} readings, {} of them not believed; learnt from {} pairs\n",
            report.readings + report.rejected,
            report.rejected,
            report.pairs
        ))?;
        notify(&format!("wrote {}", to.display()));
    }
    Ok(solved.network)
}

/// Each reading that was believed, where the first round's filter has it and where the network puts it.
fn write_trajectories(path: &Path, solved: &Cascade) -> Result<(), TableError> {
    let mut table = TableWriter::create(
        path,
        &[
            "t",
            "sensor",
            "x",
            "y",
            "z",
            "filtered_x",
            "filtered_y",
            "filtered_z",
            "corrected_x",
            "corrected_y",
            "corrected_z",
        ],
    )?;
    for (frame, pole) in solved.run.frames.iter().zip(&solved.track.poles) {
        for (sensor, reading) in frame.readings.iter().enumerate() {
            let Some(reading) = reading else { continue };
            let filtered = pole.map(|pole| pole.position_m(solved.run.offset_m(sensor)));
            let corrected = solved.network.correct(&reading.position_m);
            table.number(frame.t_s)?;
            table.text(&solved.run.sensors[sensor])?;
            for p in [Some(reading.position_m), filtered, Some(corrected)] {
                table.vector::<3>(p.map(|p: Vector3<f64>| p.into()))?;
            }
            table.end_row()?;
        }
    }
    table.finish()
}
