//! `posed segments bench`: what a network with random weights costs here.

#![expect(clippy::disallowed_methods, reason = "this command is a stopwatch")]

use std::time::Instant;

use posed_motion::segments::{SegmentationNetwork, Stream, Workspace, cross_entropy};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use super::super::{Error, print, print_json};

/// What to time.
#[derive(clap::Args)]
#[command(after_help = "Example:\n  posed segments bench --rows 19 --frames 1300 --repeat 20")]
pub(crate) struct Args {
    /// Joint rows of the input: 224 is the paper's image (663562 parameters), 19 the joints themselves (545482).
    #[arg(long, default_value_t = 19, value_parser = clap::value_parser!(u32).range(1..=1024))]
    rows: u32,
    /// Joints, to which an image of other rows is folded once it is trained: whole sequences and streams are those of the folded
    /// network then. Not folded unless given.
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1024))]
    joints: Option<u32>,
    /// Frames of the sequence.
    #[arg(long, default_value_t = 1300, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    frames: u32,
    /// Threads: as many sequences are computed at once.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1024))]
    threads: u32,
    /// Repetitions; the median counts.
    #[arg(long, default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    repeat: u32,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

/// The answer for programs: medians and least values, ms; of one sequence on one thread.
#[derive(Serialize)]
struct Answer {
    rows: u32,
    joints: Option<u32>,
    frames: u32,
    threads: u32,
    repeat: u32,
    /// Of the network with the rows that were asked for, which learns, and of the one that labels.
    parameters: usize,
    labelling_parameters: usize,
    /// One sequence forwards, labelling.
    inference_ms: f64,
    inference_least_ms: f64,
    /// One sequence forwards and backwards, with the rows that were asked for.
    step_ms: f64,
    step_least_ms: f64,
    /// One frame of a stream.
    stream_frame_ms: f64,
    /// Sequences forwards per second, all threads together.
    sequences_per_s: f64,
}

pub(crate) fn run(args: Args) -> Result<(), Error> {
    let classes = 10;
    let shape = posed_baselines::segments::shape(3 * args.rows as usize, classes);
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let network = SegmentationNetwork::<f32>::random(shape.clone(), &mut rng);
    let frames = args.frames as usize;
    let mut draw = |network: &SegmentationNetwork<f32>| -> Vec<f32> {
        (0..frames * network.shape().inputs).map(|_| rng.random_range(0.0..1.0)).collect()
    };
    let x = draw(&network);
    // A trained network is folded before it labels anything.
    let labelling = match args.joints {
        Some(joints) => network.folded(args.rows as usize, joints as usize),
        None => network.clone(),
    };
    let joints = draw(&labelling);
    let truth: Vec<u16> = (0..frames).map(|frame| (frame / 97 % classes) as u16).collect();
    let weights = vec![1.0; frames];
    let mut work = Workspace::default();
    let times = |what: &mut dyn FnMut()| {
        what();
        let mut times: Vec<f64> = (0..args.repeat)
            .map(|_| {
                let start = Instant::now();
                what();
                start.elapsed().as_secs_f64() * 1e3
            })
            .collect();
        times.sort_by(f64::total_cmp);
        (times[times.len() / 2], times[0])
    };
    let (inference_ms, inference_least_ms) = times(&mut || labelling.infer(&joints, &mut work));
    let (mut gradient, mut slope) = (vec![0.0; shape.parameters()], Vec::new());
    let (step_ms, step_least_ms) = times(&mut || {
        network.forward(&x, &[], &mut work);
        cross_entropy(work.scores(), classes, &truth, &weights, 0.0, &mut slope);
        network.backward(&x, &[], &slope, &mut work, &mut gradient, None);
    });
    let mut stream = Stream::new(&labelling);
    let (stream_ms, _) = times(&mut || {
        for row in joints.chunks_exact(labelling.shape().inputs) {
            std::hint::black_box(stream.push(&labelling, row));
        }
    });
    let pool = rayon::ThreadPoolBuilder::new().num_threads(args.threads as usize).build();
    let pool = pool.map_err(Error::failed)?;
    let start = Instant::now();
    pool.broadcast(|_| {
        let mut work = Workspace::default();
        (0..args.repeat).for_each(|_| labelling.infer(&joints, &mut work));
    });
    let sequences_per_s = f64::from(args.threads * args.repeat) / start.elapsed().as_secs_f64();
    let answer = Answer {
        rows: args.rows,
        joints: args.joints,
        frames: args.frames,
        threads: args.threads,
        repeat: args.repeat,
        parameters: shape.parameters(),
        labelling_parameters: labelling.shape().parameters(),
        inference_ms,
        inference_least_ms,
        step_ms,
        step_least_ms,
        stream_frame_ms: stream_ms / f64::from(args.frames),
        sequences_per_s,
    };
    if args.json {
        return print_json(&answer);
    }
    let folded = match args.joints {
        Some(joints) => format!(" ({} once folded to {joints} joints)", answer.labelling_parameters),
        None => String::new(),
    };
    print(&format!(
        "{} parameters{folded}, {} frames, median (least) of {}\n\
         forwards               {inference_ms:8.2} ms ({inference_least_ms:.2})\n\
         forwards and backwards {step_ms:8.2} ms ({step_least_ms:.2})\n\
         one frame of a stream  {:8.4} ms\n\
         {} thread(s) together   {sequences_per_s:8.1} sequences/s\n",
        answer.parameters, args.frames, args.repeat, answer.stream_frame_ms, args.threads
    ))
}
