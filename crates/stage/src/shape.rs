//! Holds a parsed TOML document against the JSON schema of its type: unknown keys, missing keys, wrong types,
//! words that are not in a list, numbers out of range, lists of the wrong length.
//!
//! Serde would stop at the first of these, and loses the line below a flattened table. The schema comes from the
//! same types, so both always agree; serde has the last word ([`super::check()`]).

use std::ops::Range;

use serde_json::Value as Schema;
use toml::Spanned;
use toml::de::{DeString, DeTable, DeValue};

use super::problem::{Notes, nearest, one_of};

/// How far the norm of a quaternion may be from 1: three digits per component are enough to write one.
const UNIT_TOLERANCE: f64 = 2e-3;

/// A walk over a document beside its schema.
pub(super) struct Shape<'a, 't> {
    schema: &'a Schema,
    notes: &'a mut Notes<'t>,
    /// Whether the text had broken syntax: a key that seems to be missing may stand in what could not be read.
    recovered: bool,
}

impl<'a, 't> Shape<'a, 't> {
    pub(super) fn new(schema: &'a Schema, notes: &'a mut Notes<'t>, recovered: bool) -> Self {
        Self { schema, notes, recovered }
    }

    /// Checks the table that the schema describes.
    pub(super) fn document(&mut self, header: Range<usize>, table: &DeTable<'_>) {
        let schema = self.schema;
        self.table(schema, "", header, table);
    }

    /// Follows `$ref`, and drops the `null` of an optional value.
    fn resolve(&self, mut schema: &'a Schema) -> &'a Schema {
        // A schema of finite types has no chain this long.
        for _ in 0..8 {
            if let Some(name) = schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) {
                schema = &self.schema["$defs"][name];
            } else if let Some([one, other]) = schema["anyOf"].as_array().map(Vec::as_slice) {
                match (one["type"] == "null", other["type"] == "null") {
                    (false, true) => schema = one,
                    (true, false) => schema = other,
                    _ => return schema,
                }
            } else {
                return schema;
            }
        }
        schema
    }

    fn table(&mut self, schema: &'a Schema, name: &str, header: Range<usize>, table: &DeTable<'_>) {
        let mut fields = Fields::default();
        fields.add(schema);
        if let Some(union) = Union::of(schema) {
            match self.alternative(&union, &header, table) {
                Some(alternative) => {
                    fields.add(alternative);
                    if !alternative["$ref"].is_null() {
                        fields.add(self.resolve(alternative));
                    }
                }
                // Its keys cannot be distinguished from strangers.
                None => {
                    fields.open = true;
                    fields.required.retain(|key| *key != union.tag);
                }
            }
        }
        let names = || fields.properties.iter().map(|(name, _)| *name);
        let strangers = table.keys().filter(|key| !fields.open && fields.schema(key.get_ref()).is_none());
        let misspelt: Vec<&str> = strangers.filter_map(|key| nearest(key.get_ref(), names())).collect();
        for key in &fields.required {
            // A key that stands there with a misspelt name is reported once, where it stands.
            if !self.recovered && !table.contains_key(*key) && !misspelt.contains(key) {
                let about = fields.schema(key).map(|schema| self.about(schema)).unwrap_or_default();
                let place = if name.is_empty() { String::new() } else { format!(" of [{name}]") };
                let message = format!("the key `{key}`{place} is missing");
                self.notes.problem(&header, key, message, format!("add `{key}`: {about}"));
            }
        }
        for (key, value) in table {
            match fields.schema(key.get_ref()) {
                Some(schema) => self.value(schema, key, value),
                None if fields.open => {}
                None => self.unknown(key, &fields),
            }
        }
    }

    fn unknown(&mut self, key: &Spanned<DeString<'_>>, fields: &Fields<'a>) {
        let names = || fields.properties.iter().map(|(name, _)| *name);
        let fix = match nearest(key.get_ref(), names()) {
            Some(word) => format!("did you mean `{word}`?"),
            None => format!("remove it; the keys here are {}", one_of(names())),
        };
        self.notes.problem(&key.span(), key.get_ref(), "no such key here", fix);
    }

    /// The member of a union that the table's tag names.
    fn alternative(
        &mut self,
        union: &Union<'a>,
        header: &Range<usize>,
        table: &DeTable<'_>,
    ) -> Option<&'a Schema> {
        let tag = union.tag;
        let words = || union.alternatives.iter().map(|(word, _)| *word);
        let Some((key, value)) = table.get_key_value(tag) else {
            if !self.recovered {
                let fix = format!("add `{tag}`: {}", one_of(words()));
                self.notes.problem(header, tag, format!("the key `{tag}` is missing"), fix);
            }
            return None;
        };
        let Some(word) = value.get_ref().as_str() else {
            self.wrong_type(key, value, &format!("one of the words {}", one_of(words())));
            return None;
        };
        let found = union.alternatives.iter().find(|(name, _)| *name == word);
        if found.is_none() {
            self.wrong_word(key, value, word, &words().collect::<Vec<_>>());
        }
        found.map(|(_, schema)| *schema)
    }

    fn value(&mut self, schema: &'a Schema, key: &Spanned<DeString<'_>>, value: &Spanned<DeValue<'_>>) {
        if self.recovered && value.span().is_empty() {
            // The parser's own guess at what could not be read.
            return;
        }
        let schema = self.resolve(schema);
        if let Some(words) = words(schema) {
            match value.get_ref().as_str() {
                Some(word) if words.contains(&word) => {}
                Some(word) => self.wrong_word(key, value, word, &words),
                None => self.wrong_type(key, value, &format!("one of the words {}", one_of(words))),
            }
            return;
        }
        match (kind(schema), value.get_ref()) {
            (Some("object"), DeValue::Table(table)) => {
                self.table(schema, key.get_ref(), value.span(), table);
            }
            (Some("array"), DeValue::Array(items)) => self.array(schema, key, value, items),
            // One of them may stand without the second pair of brackets.
            (Some("array"), DeValue::Table(_)) if schema["x-or-table"] == true => {
                self.value(&schema["items"], key, value);
            }
            (Some("integer"), DeValue::Integer(_))
            | (Some("number"), DeValue::Integer(_) | DeValue::Float(_)) => {
                self.number(schema, key, value);
            }
            (Some("string"), DeValue::String(text)) => self.text(schema, key, value, text),
            (Some("boolean"), DeValue::Boolean(_)) | (None, _) => {}
            (Some(_), _) => {
                let expected = self.expected(schema);
                self.wrong_type(key, value, &expected);
            }
        }
    }

    fn array(
        &mut self,
        schema: &'a Schema,
        key: &Spanned<DeString<'_>>,
        value: &Spanned<DeValue<'_>>,
        items: &[Spanned<DeValue<'_>>],
    ) {
        let (least, most) = (schema["minItems"].as_u64(), schema["maxItems"].as_u64());
        let count = items.len() as u64;
        if least.is_some_and(|least| count < least) || most.is_some_and(|most| count > most) {
            let expected = self.expected(schema);
            let message =
                format!("{count} values are too {}", if most < Some(count) { "many" } else { "few" });
            self.notes.problem(&value.span(), key.get_ref(), message, format!("write {expected}"));
            return;
        }
        for item in items {
            self.value(&schema["items"], key, item);
        }
        if key.get_ref().ends_with("_wxyz") {
            self.unit_quaternion(key, value, items);
        }
    }

    fn unit_quaternion(
        &mut self,
        key: &Spanned<DeString<'_>>,
        value: &Spanned<DeValue<'_>>,
        items: &[Spanned<DeValue<'_>>],
    ) {
        let Some(q) = items.iter().map(|item| as_number(item.get_ref())).collect::<Option<Vec<f64>>>() else {
            return;
        };
        let norm = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        if !norm.is_finite() || (norm - 1.0).abs() <= UNIT_TOLERANCE {
            return;
        }
        let fix = if norm > 1e-6 {
            let unit: Vec<String> = q.iter().map(|x| format!("{:.6}", x / norm)).collect();
            format!("write [{}], if the direction is right; w comes first", unit.join(", "))
        } else {
            "write [1.0, 0.0, 0.0, 0.0] for no rotation".to_owned()
        };
        self.notes.problem(
            &value.span(),
            key.get_ref(),
            format!("the quaternion's norm is {norm:.4}, not 1"),
            fix,
        );
    }

    fn number(&mut self, schema: &Schema, key: &Spanned<DeString<'_>>, value: &Spanned<DeValue<'_>>) {
        let number = as_number(value.get_ref()).unwrap_or(f64::NAN);
        let expected = self.expected(schema);
        if !number.is_finite() {
            self.notes.problem(
                &value.span(),
                key.get_ref(),
                "not a finite number",
                format!("write {expected}"),
            );
            return;
        }
        if let Some(allowed) = schema["enum"].as_array() {
            if !allowed.iter().filter_map(Schema::as_f64).any(|allowed| allowed == number) {
                let message = format!("{number} is not among the values it can have");
                self.notes.problem(&value.span(), key.get_ref(), message, format!("write {expected}"));
            }
            return;
        }
        let bound = |name: &str| schema[name].as_f64();
        let below = bound("minimum").is_some_and(|least| number < least)
            || bound("exclusiveMinimum").is_some_and(|least| number <= least);
        let above = bound("maximum").is_some_and(|most| number > most)
            || bound("exclusiveMaximum").is_some_and(|most| number >= most);
        if below || above {
            let message = format!("{number} is too {}", if below { "small" } else { "large" });
            self.notes.problem(&value.span(), key.get_ref(), message, format!("write {expected}"));
        }
    }

    fn text(
        &mut self,
        schema: &Schema,
        key: &Spanned<DeString<'_>>,
        value: &Spanned<DeValue<'_>>,
        text: &str,
    ) {
        let count = text.chars().count() as u64;
        if let Some(least) = schema["minLength"].as_u64().filter(|least| count < *least) {
            let (message, fix) = if count == 0 {
                ("empty".to_owned(), format!("write {}", self.about(schema)))
            } else {
                (format!("{count} characters are too few"), format!("write at least {least} characters"))
            };
            self.notes.problem(&value.span(), key.get_ref(), message, fix);
        }
        if let Some(most) = schema["maxLength"].as_u64().filter(|most| count > *most) {
            let message = format!("{count} characters are too many");
            self.notes.problem(
                &value.span(),
                key.get_ref(),
                message,
                format!("write at most {most} characters"),
            );
        }
    }

    fn wrong_word(
        &mut self,
        key: &Spanned<DeString<'_>>,
        value: &Spanned<DeValue<'_>>,
        word: &str,
        words: &[&str],
    ) {
        let (key, at) = (key.get_ref(), value.span());
        let fix = match nearest(word, words.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("write {}", one_of(words.iter().copied())),
        };
        self.notes.problem(&at, key, format!("`{word}` is not a word for {key}"), fix);
    }

    fn wrong_type(&mut self, key: &Spanned<DeString<'_>>, value: &Spanned<DeValue<'_>>, expected: &str) {
        let name = key.get_ref();
        let fix = match value.get_ref() {
            DeValue::Table(_) if expected.starts_with("a list of tables") => {
                format!("write [[{name}]] with two pairs of brackets")
            }
            DeValue::Array(_) if expected.starts_with("a table") => {
                format!("write [{name}] with one pair of brackets, and once only")
            }
            DeValue::String(text) if expected.contains("number") && text.trim().parse::<f64>().is_ok() => {
                format!("write {} without quotes", text.trim())
            }
            DeValue::Float(float) if expected.starts_with("a whole number") => {
                match float.as_str().parse::<f64>() {
                    Ok(number) if number.is_finite() => {
                        format!("write {} without a decimal point", number.round())
                    }
                    _ => format!("write {expected}"),
                }
            }
            _ => format!("write {expected}"),
        };
        let got = match value.get_ref() {
            DeValue::String(_) => "text",
            DeValue::Integer(_) => "a whole number",
            DeValue::Float(_) => "a number",
            DeValue::Boolean(_) => "true or false",
            DeValue::Datetime(_) => "a date",
            DeValue::Array(_) => "a list",
            DeValue::Table(_) => "a table",
        };
        self.notes.problem(&value.span(), name, format!("this is {got}, expected is {expected}"), fix);
    }

    /// What a value has to look like, in words.
    fn expected(&self, schema: &Schema) -> String {
        let numbers = |schema: &Schema, noun: &str| {
            if let Some(allowed) = schema["enum"].as_array() {
                let allowed: Vec<String> = allowed.iter().map(ToString::to_string).collect();
                return format!("{noun}: one of {}", allowed.join(", "));
            }
            let bound = |name: &str| schema[name].as_f64();
            let least = match (bound("minimum"), bound("exclusiveMinimum")) {
                (_, Some(least)) => format!(" above {least}"),
                (Some(least), None) => format!(" from {least}"),
                (None, None) => String::new(),
            };
            let most = match (bound("maximum"), bound("exclusiveMaximum")) {
                (_, Some(most)) => format!(" below {most}"),
                (Some(most), None) if least.starts_with(" from") => format!(" to {most}"),
                (Some(most), None) => format!(" up to {most}"),
                (None, None) => String::new(),
            };
            format!("{noun}{least}{most}")
        };
        match kind(schema) {
            Some("integer") => numbers(schema, "a whole number"),
            Some("number") => numbers(schema, "a number"),
            Some("string") => "text in quotes".to_owned(),
            Some("boolean") => "true or false".to_owned(),
            Some("object") => "a table".to_owned(),
            Some("array") => {
                let item = schema["items"].as_object().map(|_| self.resolve_any(&schema["items"]));
                let noun = match item.and_then(kind) {
                    Some("object") => "tables",
                    Some("string") => "texts",
                    _ => "numbers",
                };
                match (schema["minItems"].as_u64(), schema["maxItems"].as_u64()) {
                    (Some(least), Some(most)) if least == most => format!("a list of {least} {noun}"),
                    _ => format!("a list of {noun}"),
                }
            }
            _ => "another value".to_owned(),
        }
    }

    /// As [`Self::resolve`], for schemas of any life time.
    fn resolve_any<'s>(&'s self, schema: &'s Schema) -> &'s Schema {
        match schema["$ref"].as_str().and_then(|path| path.strip_prefix("#/$defs/")) {
            Some(name) => &self.schema["$defs"][name],
            None => schema,
        }
    }

    /// What a key is for: its words, or its type with the first sentence of its documentation.
    fn about(&self, schema: &'a Schema) -> String {
        let inner = self.resolve(schema);
        let expected = match words(inner) {
            Some(words) => one_of(words),
            None => self.expected(inner),
        };
        let sentence = schema["description"].as_str().map(first_sentence).unwrap_or_default();
        if sentence.is_empty() { expected } else { format!("{expected} ({sentence})") }
    }
}

/// The keys that a table may have and must have.
#[derive(Default)]
struct Fields<'a> {
    properties: Vec<(&'a str, &'a Schema)>,
    required: Vec<&'a str>,
    open: bool,
}

impl<'a> Fields<'a> {
    fn add(&mut self, schema: &'a Schema) {
        if let Some(properties) = schema["properties"].as_object() {
            self.properties.extend(properties.iter().map(|(name, schema)| (name.as_str(), schema)));
        }
        for name in schema["required"].as_array().into_iter().flatten().filter_map(Schema::as_str) {
            self.required.push(name);
        }
        self.open |= schema["additionalProperties"] == true;
    }

    fn schema(&self, key: &str) -> Option<&'a Schema> {
        self.properties.iter().find(|(name, _)| *name == key).map(|(_, schema)| *schema)
    }
}

/// A choice of tables, distinguished by the word under one key.
struct Union<'a> {
    tag: &'a str,
    alternatives: Vec<(&'a str, &'a Schema)>,
}

impl<'a> Union<'a> {
    fn of(schema: &'a Schema) -> Option<Self> {
        let alternatives = schema["oneOf"].as_array()?;
        let is_tag = |(_, property): &(&String, &Schema)| property["const"].is_string();
        let (tag, _) = alternatives.first()?["properties"].as_object()?.iter().find(is_tag)?;
        let alternatives = alternatives
            .iter()
            .map(|alternative| Some((alternative["properties"][tag]["const"].as_str()?, alternative)))
            .collect::<Option<Vec<_>>>()?;
        Some(Self { tag, alternatives })
    }
}

/// The type of a schema, without `null`.
fn kind(schema: &Schema) -> Option<&str> {
    match &schema["type"] {
        Schema::String(kind) => Some(kind),
        Schema::Array(kinds) => kinds.iter().filter_map(Schema::as_str).find(|kind| *kind != "null"),
        _ => Union::of(schema).map(|_| "object"),
    }
}

/// The words of a schema that is a choice of words.
fn words(schema: &Schema) -> Option<Vec<&str>> {
    if let Some(list) = schema["enum"].as_array() {
        let words: Vec<&str> = list.iter().filter_map(Schema::as_str).collect();
        return (!words.is_empty()).then_some(words);
    }
    if let Some(word) = schema["const"].as_str() {
        return Some(vec![word]);
    }
    let mut words = Vec::new();
    for alternative in schema["oneOf"].as_array()? {
        // Words with and without documentation come in lists of their own.
        match (alternative["const"].as_str(), alternative["enum"].as_array()) {
            (Some(word), _) => words.push(word),
            (None, Some(list)) => words.extend(list.iter().filter_map(Schema::as_str)),
            (None, None) => return None,
        }
    }
    (!words.is_empty()).then_some(words)
}

pub(super) fn as_number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Integer(integer) => {
            i128::from_str_radix(integer.as_str(), integer.radix()).ok().map(|integer| integer as f64)
        }
        DeValue::Float(float) => float.as_str().parse().ok(),
        _ => None,
    }
}

fn first_sentence(text: &str) -> String {
    let flat = text.split_whitespace().collect::<Vec<_>>().join(" ");
    match flat.find(". ") {
        Some(end) => flat[..end].to_owned(),
        None => flat.trim_end_matches('.').to_owned(),
    }
}
