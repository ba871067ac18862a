//! A pipeline that has taken something from outside goes on: as many frames, in numbers, and the same from a snapshot.

use posed_pipeline::Pipeline;
use posed_protocol::{Fields, Payload, Publisher, ServerMessage};
use posed_stage::Stage;
use posed_stage::input::{Entry, Input};

use crate::stand::Stand;

/// Gives inputs to a copy of the stand's pipeline, and lets it go on. Whether anything was taken.
pub(crate) fn put_in(stand: &Stand, inputs: impl IntoIterator<Item = Input>) -> bool {
    let mut pipeline = stand.pipeline.clone();
    let refused = |pipeline: &Pipeline| {
        let status = pipeline.status();
        status.models_refused + status.requests_refused
    };
    let before = refused(&pipeline);
    let mut given = 0;
    for input in inputs {
        pipeline.push(&Entry { t: stand.now, input }, &mut |_| {});
        given += 1;
    }
    let taken = refused(&pipeline) - before < given;
    if taken {
        go_on(&stand.stage, pipeline, &stand.next);
    }
    taken
}

/// # Panics
/// Where a message is none, or a pipeline that was restored says another.
pub(crate) fn go_on(stage: &Stage, mut pipeline: Pipeline, log: &[Entry]) {
    let mut again = Pipeline::restore(stage, pipeline.models(), &pipeline.snapshot())
        .unwrap_or_else(|error| panic!("its own snapshot: {error}"));
    for entry in log {
        let said = say(stage, &mut pipeline, entry);
        assert_eq!(said, say(stage, &mut again, entry), "a restored pipeline says something else");
        for message in said {
            let read: Result<ServerMessage, _> = serde_json::from_slice(&message);
            assert!(read.is_ok(), "no message: {read:?} {}", String::from_utf8_lossy(&message));
        }
    }
    assert!(pipeline.snapshot() == again.snapshot(), "a restored pipeline stands elsewhere");
}

/// What an entry makes a pipeline say, as messages with all fields.
fn say(stage: &Stage, pipeline: &mut Pipeline, entry: &Entry) -> Vec<Vec<u8>> {
    let mut publisher = Publisher::new(stage, Fields::all());
    let mut messages = Vec::new();
    pipeline.push(entry, &mut |output| {
        if let Some(payload) = Payload::of(&output) {
            messages.push(publisher.publish(&payload).1.to_vec());
        }
    });
    messages
}
