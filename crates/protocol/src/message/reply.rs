//! Replies to requests.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::Answer;
use crate::RequestId;

/// Reply to a request that was carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OkReply {
    /// The request's.
    pub id: Option<RequestId>,
    /// What was asked for, where the request asks for something: see `Answers`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub result: Option<Answer>,
}

/// Reply to a request that was not carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct ErrorReply {
    /// The request's; null where it could not be read.
    pub id: Option<RequestId>,
    /// For programs: `bad_message`, `bad_request`, `unknown_type`, `unknown_sensor`, `forbidden`, `busy`, ...
    pub code: String,
    /// For people: what was wrong and what would be right, in one sentence.
    pub message: String,
}
