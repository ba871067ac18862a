//! Plans.

use rusqlite::params;

use super::{Store, StoreError};
use crate::plan::{Plan, PlanStep};

impl Store {
    /// Keeps a plan, in the place of one of the same name.
    ///
    /// # Errors
    /// It is out of bounds, or the database does not serve.
    pub fn save_plan(&mut self, plan: &Plan) -> Result<(), StoreError> {
        plan.check()?;
        let transaction = self.connection.transaction()?;
        transaction.execute("DELETE FROM plan WHERE name = ?1", [&plan.name])?;
        transaction.execute("INSERT INTO plan (name) VALUES (?1)", [&plan.name])?;
        let id = transaction.last_insert_rowid();
        for (position, step) in (0_i64..).zip(&plan.steps) {
            transaction.execute(
                "INSERT INTO plan_step VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
                params![id, position, step.exercise, step.sets, step.repetitions, step.rest_s],
            )?;
        }
        Ok(transaction.commit()?)
    }

    /// All plans, by name.
    ///
    /// # Errors
    /// The database cannot be read.
    pub fn plans(&self) -> Result<Vec<Plan>, StoreError> {
        let mut statement = self.connection.prepare_cached(
            "SELECT name, exercise, sets, repetitions, rest_s FROM plan JOIN plan_step ON plan_step.plan = plan.id
             ORDER BY name, position",
        )?;
        let mut rows = statement.query([])?;
        let mut plans: Vec<Plan> = Vec::new();
        while let Some(row) = rows.next()? {
            let name: String = row.get(0)?;
            let step = PlanStep {
                exercise: row.get(1)?,
                sets: row.get(2)?,
                repetitions: row.get(3)?,
                rest_s: row.get(4)?,
            };
            match plans.last_mut().filter(|plan| plan.name == name) {
                Some(plan) => plan.steps.push(step),
                None => plans.push(Plan { name, steps: vec![step] }),
            }
        }
        Ok(plans)
    }

    /// One plan.
    ///
    /// # Errors
    /// There is none of this name, or the database cannot be read.
    pub fn plan(&self, name: &str) -> Result<Plan, StoreError> {
        let found = self.plans()?.into_iter().find(|plan| plan.name == name);
        found.ok_or_else(|| StoreError::NoPlan(name.to_owned()))
    }

    /// Removes a plan; sessions that followed it keep its name.
    ///
    /// # Errors
    /// There is none of this name, or the database does not serve.
    pub fn delete_plan(&mut self, name: &str) -> Result<(), StoreError> {
        match self.connection.execute("DELETE FROM plan WHERE name = ?1", [name])? {
            0 => Err(StoreError::NoPlan(name.to_owned())),
            _ => Ok(()),
        }
    }
}
