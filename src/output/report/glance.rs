//! What is seen first: the maps of all methods.

use super::maps;
use super::page::{PageError, Report};
use super::section::{Choice, Figure, Folded, Section};
use crate::event::RunInfo;

impl Report {
    /// The maps of the last cycle, and folded those of others, among which the script lets a reader choose.
    pub(super) fn maps(
        &mut self,
        info: &RunInfo,
        all: Vec<maps::MapsOfCycle>,
        others: Vec<(String, Vec<maps::Drawing>)>,
        first: Option<Figure>,
    ) -> Result<Section, PageError> {
        let (title, short) = ("At a glance".into(), "At a glance".into());
        let mut section = Section { title, short, figures: first.into_iter().collect(), ..Section::default() };
        let (shown, about) = if info.has_truth {
            ("error", "Root-mean-square errors, actual and claimed; the truth; and the error of every method.")
        } else {
            ("analysis", "The analysis of every method.")
        };
        for (number, maps) in all.into_iter().enumerate() {
            let when = format!("cycle {}, {}", maps.cycle, maps.time);
            let mut draw = |drawing: maps::Drawing, method: Option<&String>, kind: &'static str| {
                let choice = Choice { cycle: maps.cycle, when: when.clone(), method: method.cloned(), kind };
                self.map(drawing).map(|figure| Figure { choice: Some(choice), ..figure })
            };
            let mut figures = Vec::new();
            if let Some(truth) = maps.truth {
                figures.push(draw(truth, None, "truth")?);
            }
            let mut more = Vec::new();
            for (name, own) in maps.methods {
                let background = draw(own.background, Some(&name), "background")?;
                let analysis = draw(own.analysis, Some(&name), "analysis")?;
                let (mut others, mut words) = (vec![background], "background with observations");
                match own.error {
                    Some(error) => {
                        figures.push(draw(error, Some(&name), "error")?);
                        others.push(analysis);
                        words = "background with observations, analysis";
                    }
                    None => figures.push(analysis),
                }
                let mut claims = "";
                if let Some(spread) = own.spread {
                    others.push(draw(spread, Some(&name), "spread")?);
                    claims = ", claimed spread";
                }
                more.push(Folded { title: format!("{name}: {words}{claims}"), figures: others, ..Folded::default() });
            }
            if number == 0 {
                section.title = format!("At a glance: {when}");
                section.text = format!("{about} All maps of a kind have the same colours for the same values.");
                section.figures.extend(figures);
                section.folded = more;
            } else {
                let title = format!("The same of {when}");
                figures.extend(more.into_iter().flat_map(|part| part.figures));
                section.folded.push(Folded { title, figures, ..Folded::default() });
            }
        }
        for (variable, drawings) in others {
            let figures = self.draw(drawings)?;
            let title = format!("{variable}: {shown} and claimed spread of every method in the last cycle");
            section.folded.push(Folded { title, figures, ..Folded::default() });
        }
        Ok(section)
    }
}
