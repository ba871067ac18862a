-- Angles are in hundredths of a degree, times in seconds since the epoch of the session's stage.
CREATE TABLE person (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;

CREATE TABLE plan (
    id INTEGER PRIMARY KEY,
    name TEXT NOT NULL UNIQUE
) STRICT;

CREATE TABLE plan_step (
    plan INTEGER NOT NULL REFERENCES plan ON DELETE CASCADE,
    position INTEGER NOT NULL,
    exercise TEXT NOT NULL,
    sets INTEGER NOT NULL,
    repetitions INTEGER NOT NULL,
    rest_s REAL NOT NULL,
    PRIMARY KEY (plan, position)
) STRICT, WITHOUT ROWID;

-- `joints`: JSON, a list of names with the demonstration of each in degrees.
CREATE TABLE lesson (
    id INTEGER PRIMARY KEY,
    exercise TEXT NOT NULL,
    revision INTEGER NOT NULL,
    duration_s REAL NOT NULL,
    joints TEXT NOT NULL,
    UNIQUE (exercise, revision, duration_s, joints)
) STRICT;

CREATE TABLE session (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    person INTEGER NOT NULL REFERENCES person ON DELETE CASCADE,
    plan TEXT,
    stage TEXT NOT NULL,
    subject TEXT NOT NULL,
    epoch_utc_ns INTEGER NOT NULL,
    t_begin_s REAL NOT NULL,
    t_end_s REAL,
    ended_by TEXT,
    recording TEXT
) STRICT;
CREATE INDEX session_of_person ON session (person);

CREATE TABLE training_set (
    id INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES session ON DELETE CASCADE,
    number INTEGER NOT NULL,
    lesson INTEGER NOT NULL REFERENCES lesson,
    planned INTEGER,
    UNIQUE (session, number)
) STRICT;
CREATE INDEX training_set_of_lesson ON training_set (lesson);

CREATE TABLE correction (
    id INTEGER PRIMARY KEY,
    training_set INTEGER NOT NULL REFERENCES training_set ON DELETE CASCADE,
    counted INTEGER NOT NULL,
    corrected INTEGER NOT NULL,
    utc_ns INTEGER NOT NULL
) STRICT;
CREATE INDEX correction_of_set ON correction (training_set);

CREATE TABLE repetition (
    training_set INTEGER NOT NULL REFERENCES training_set ON DELETE CASCADE,
    position INTEGER NOT NULL,
    number INTEGER,
    t_start_s REAL NOT NULL,
    t_end_s REAL NOT NULL,
    t_decided_s REAL NOT NULL,
    reason TEXT,
    score_total REAL,
    score_amplitude REAL,
    score_tempo REAL,
    score_smoothness REAL,
    score_symmetry REAL,
    sentence TEXT,
    sentence_de TEXT,
    PRIMARY KEY (training_set, position)
) STRICT, WITHOUT ROWID;

-- `course`: 32 numbers of 16 bits, little end first, from the beginning of the repetition to its end.
CREATE TABLE joint (
    training_set INTEGER NOT NULL,
    repetition INTEGER NOT NULL,
    joint INTEGER NOT NULL,
    least INTEGER NOT NULL,
    greatest INTEGER NOT NULL,
    course BLOB NOT NULL,
    PRIMARY KEY (training_set, repetition, joint),
    FOREIGN KEY (training_set, repetition) REFERENCES repetition (training_set, position) ON DELETE CASCADE
) STRICT, WITHOUT ROWID;
