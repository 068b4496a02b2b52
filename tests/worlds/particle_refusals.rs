//! Recipes of particles on carbon that are refused, and what the reason names.

use crate::common::specimen;
use stemgen::recipe::{Difficulty, Recipe};

#[test]
fn recipes_that_cannot_be_are_refused_with_the_reason() {
    let good = include_str!("../../generate/pt.toml");
    let cases = [
        ("count = 21 ", "count = 400", "particles.count = 400: 60 x 60 nm have room for at most"),
        (
            "diameter_nm = [2.5, 5.0]",
            "diameter_nm = [5.0, 2.5]",
            "particles.diameter_nm = [5, 2.5]: expected the least",
        ),
        (
            "diameter_nm = [2.5, 5.0]",
            "diameter_nm = [0.1, 2.5]",
            "particles.diameter_nm = 0.1: expected a value from 0.8",
        ),
        ("\"decahedral\"", "\"decahedron\"", "unknown variant"),
        ("\"decahedral\"", "\"decahedron\"", "decahedral"),
        (
            "max_tilt_deg = 2.0",
            "max_tilt_deg = -1.0",
            "particles.max_tilt_deg = -1: expected a value from 0",
        ),
        ("gap_nm = 0.5", "gap_nm = 0.1", "particles.gap_nm = 0.1: expected a value from 0.3"),
        ("contact_angstrom = 2.1", "contact_angstrom = 0.5", "particles.contact_angstrom = 0.5"),
        (
            "thickness_nm = 5.0",
            "thickness_nm = 50.0",
            "field.thickness_nm = 50: a film of carbon can have 1 to 7 nm",
        ),
        ("zone_axis = \"none\"", "zone_axis = \"[001]\"", "zone_axis = [001]"),
        ("crystal = \"pt\"", "crystal = \"si\"", "particles need a face-centred cubic metal"),
        (
            "element = \"Pt\"",
            "element = \"C\"",
            "vacancies.element = C: expected an element of the crystal: Pt",
        ),
        ("rate = 0.05", "rate = -0.05", "vacancies.rate = -0.05: expected a value from 0"),
        ("cluster_fraction = 0.0", "cluster_fraction = 0.5", "vacancies.cluster_fraction = 0.5"),
        ("[phonons]", "[boundaries]\ncount = 1\nmisorientation_deg = 3.0\n[phonons]", "boundaries"),
        ("count = 21 ", "cuont = 21 ", "did you mean `count`?"),
        ("C = 0.080", "", "`C` is missing"),
    ];
    for (from, to, expected) in cases {
        assert!(good.contains(from), "{from}");
        let text = good.replacen(from, to, 1);
        let result = Recipe::from_toml_str("pt.toml", &text, Some(Difficulty::Easy))
            .and_then(Recipe::checked);
        let message = result.expect_err(to).to_string();
        assert!(message.contains(expected), "{to}: {message}");
        assert!(message.contains("pt.toml:"), "{message}");
    }
}

/// What the limits cannot foresee: no particle of this size, no place for so many.
#[test]
fn particles_that_cannot_be_made_or_placed_are_named() {
    let mut recipe = Recipe::load("pt", Difficulty::Easy).unwrap();
    let error = |recipe: &Recipe| specimen(recipe).err().unwrap().to_string();
    recipe.particles.as_mut().unwrap().diameter_nm = [0.95, 0.951];
    let message = error(&recipe);
    assert!(message.contains("particles.diameter_nm = [0.95, 0.951]: no "), "{message}");
    // Two circles of 1.2 nm, 100 nm apart, fit by area but not into the field.
    let particles = recipe.particles.as_mut().unwrap();
    (particles.diameter_nm, particles.count, particles.gap_nm) = ([1.0, 1.5], 1, 100.0);
    assert!(specimen(&recipe).is_ok());
    recipe.particles.as_mut().unwrap().count = 2;
    let message = recipe.clone().checked().unwrap_err().to_string();
    assert!(
        message.contains("particles.count = 2: 60 x 60 nm have room for at most 1"),
        "{message}"
    );
    // A strip with the area for them, but narrower than any.
    let particles = recipe.particles.as_mut().unwrap();
    (particles.diameter_nm, particles.gap_nm) = ([1.5, 2.0], 0.3);
    recipe.field.grid = [1, 40];
    recipe.field.fov_nm = [60.0 * 128.0 / 4964.0, 60.0];
    let message = error(&recipe);
    assert!(
        message.contains("particles.count = 2: after 0 particles no place was found"),
        "{message}"
    );
}
