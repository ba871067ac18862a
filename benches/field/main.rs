//! How well the field is calibrated, and what it costs: `cargo bench --bench field`.
//!
//! `-- --seeds 5` sets the number of seeds of the table of scenes, `--scene NAME` asks for one of them; `-- --map` compares the map alone instead, and with
//! `--export DIR` writes the readings and targets that `benches/peers/field` gives to other libraries; `-- --body` solves
//! sessions of simulated people, `-- --spacing` states a wrong spacing of the pole, `-- --cascades` compares the forms of the published method.

mod body;
mod cascades;
mod cpu;
mod map;
mod scenes;
mod session;
mod spacing;
mod survey;
mod table;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let after = |name: &str| {
        let at = arguments.iter().position(|argument| argument == name)?;
        arguments.get(at + 1).cloned()
    };
    if arguments.iter().any(|argument| argument == "--body") {
        body::run();
    } else if arguments.iter().any(|argument| argument == "--map") {
        map::run(after("--export").as_deref().map(std::path::Path::new), after("--scene").as_deref());
    } else {
        let seeds = after("--seeds").and_then(|text| text.parse().ok()).unwrap_or(5);
        let scene = after("--scene");
        if arguments.iter().any(|argument| argument == "--spacing") {
            spacing::run(seeds, scene.as_deref());
        } else if arguments.iter().any(|argument| argument == "--cascades") {
            cascades::run(seeds, scene.as_deref());
        } else {
            table::run(seeds, scene.as_deref());
        }
    }
}
