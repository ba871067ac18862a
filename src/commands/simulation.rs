//! The bridge between stage files and the simulator, which must not know each other.

use std::path::Path;

use posed_simulator::scenario::{Scenario, StageSpec};
use posed_simulator::stage::VirtualStage;
use posed_stage::{Problem, Stage};
use serde::Deserialize;

use super::Error;

/// What the `[simulation]` table of a stage says; without one, a clean and quiet scene.
pub(crate) fn scenario(stage: &Stage) -> Result<Scenario, Error> {
    match &stage.simulation {
        Some(table) => Scenario::deserialize(table.clone())
            .map_err(|error| Error::Failed(format!("[simulation]: {}", error.message()))),
        None => Ok(Scenario::default()),
    }
}

/// The virtual devices of a stage; paths in its `[simulation]` table begin at `folder`.
pub(crate) fn virtual_stage(stage: &Stage, folder: &Path) -> Result<VirtualStage, Error> {
    let spec = StageSpec::of(stage).map_err(Error::failed)?;
    VirtualStage::new(&spec, &scenario(stage)?, folder).map_err(Error::failed)
}

/// What is wrong with the `[simulation]` table of a stage file that is otherwise right, and with the files of motion that it names, from `folder` on.
pub(crate) fn problems(text: &str, stage: &Stage, folder: &Path) -> Vec<Problem> {
    let schema = schemars::schema_for!(Scenario).to_value();
    let mut problems = posed_stage::check_table(text, "simulation", &schema);
    if problems.is_empty()
        && let Err(error) = scenario(stage).and_then(|scenario| {
            let spec = StageSpec::of(stage).map_err(Error::failed)?;
            scenario.check(&spec).map_err(Error::failed)?;
            scenario.check_files(folder).map_err(Error::failed)
        })
    {
        problems.push(Problem {
            line: 1 + text.lines().position(|line| line.trim_start().starts_with("[simulation")).unwrap_or(0),
            key: "simulation".to_owned(),
            message: error.to_string(),
            fix: "change the value; config/README.md explains the keys".to_owned(),
        });
    }
    problems
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEMO: &str = include_str!("../../config/demo.toml");

    fn problems_of(text: &str) -> Vec<(usize, String)> {
        let stage = Stage::parse(text).unwrap();
        problems(text, &stage, Path::new("config"))
            .into_iter()
            .map(|problem| (problem.line, problem.key))
            .collect()
    }

    #[test]
    fn the_demo_can_be_simulated() {
        assert_eq!(problems_of(DEMO), []);
        let stage = Stage::parse(DEMO).unwrap();
        let moving = scenario(&stage).unwrap().sensors.len();
        assert!(moving >= 2 && moving == stage.sensors.len());
        // The simulator tests its own copy for distances and distortion.
        let tested = include_str!("../../simulator/resources/demo-simulation.toml");
        assert_eq!(scenario(&stage).unwrap(), toml::from_str(tested).unwrap());
    }

    #[test]
    fn every_problem_of_the_simulation_has_its_line() {
        let line = |text: &str| 1 + DEMO.lines().position(|line| line.starts_with(text)).unwrap();
        let text = DEMO.replace("seed = 7 ", "sede = 7 ").replace("kind = \"person\"", "kind = \"persons\"");
        let kind = line("kind = \"person\"");
        assert_eq!(problems_of(&text), [(line("seed"), "sede".into()), (kind, "kind".into())]);
        let text = DEMO.replace("activity = \"workout\"", "follows = [\"nobody.bvh\"]");
        let stage = Stage::parse(&text).unwrap();
        let found = problems(&text, &stage, Path::new("config"));
        assert!(found[0].message.contains("config/nobody.bvh: "), "{}", found[0].message);
        // What the simulator alone can tell points at the table.
        let text = DEMO.replace("body = \"circle\"", "body = \"square\"");
        assert_eq!(problems_of(&text), [(line("[simulation]"), "simulation".into())]);
    }
}
