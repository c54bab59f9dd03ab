//! One law of every kind, with the numbers of `tests/data/make_laws.py`.

use tissuereg_fem::material::{Directions, Fibres, Law, LawKind, Parameter, Volumetric};
use tissuereg_fem::{FemError, Material};

pub const YOUNG: f64 = 10.0;
pub const POISSON: f64 = 0.45;

/// A law by its numbers, so that tests can move one of them.
#[derive(Debug, Clone)]
pub struct Recipe {
    pub name: &'static str,
    pub young: f64,
    pub poisson: f64,
    pub kind: LawKind,
    pub volumetric: Volumetric,
    /// `k1_over_mu`, `k2`, direction, tension only.
    pub fibre: Option<(f64, f64, [f64; 3], bool)>,
}

impl Recipe {
    pub fn material(&self) -> Result<Material, FemError> {
        let material = Material::neo_hookean(self.young, self.poisson)?
            .with_law(self.kind)?
            .with_volumetric(self.volumetric)?;
        match self.fibre {
            None => Ok(material),
            Some((k1_over_mu, k2, direction, tension_only)) => {
                let directions = Directions::Uniform(direction);
                material.with_fibres(Fibres { k1_over_mu, k2, tension_only, directions })
            }
        }
    }

    pub fn law(&self) -> Law {
        self.material().expect("sound").law_at(0, 0)
    }

    /// Whether small strains find the law's moduli and nothing else: a bimodular law has others
    /// where it is stretched.
    pub fn starts_as_hooke(&self) -> bool {
        self.fibre.is_none() && !matches!(self.kind, LawKind::Bimodular { .. })
    }

    /// The same with one parameter moved.
    pub fn moved(&self, parameter: Parameter, by: f64) -> Self {
        let mut other = self.clone();
        match (parameter, &mut other.kind) {
            (Parameter::Young, _) => other.young += by,
            (Parameter::Poisson, _) => other.poisson += by,
            (Parameter::Shape { name, term }, kind) => match (name, kind) {
                ("excess", LawKind::Bimodular { excess }) => *excess += by,
                ("share", LawKind::MooneyRivlin { share }) => *share += by,
                ("c2_over_c1", LawKind::Yeoh { c2_over_c1, .. }) => *c2_over_c1 += by,
                ("c3_over_c1", LawKind::Yeoh { c3_over_c1, .. }) => *c3_over_c1 += by,
                ("b", LawKind::Fung { b } | LawKind::VerondaWestmann { b }) => *b += by,
                ("alpha", LawKind::Ogden(_)) => other.kind = ogden(term, by, 3, 0.0),
                ("weight", LawKind::Ogden(_)) => other.kind = ogden(3, 0.0, term, by),
                _ => panic!("{} has no {parameter}", self.name),
            },
            (Parameter::FibreK1, _) => other.fibre.as_mut().expect("fibres").0 += by,
            (Parameter::FibreK2, _) => other.fibre.as_mut().expect("fibres").1 += by,
            _ => panic!("{} has no {parameter:?}", self.name),
        }
        other
    }
}

/// Two terms, with one exponent or weight moved.
fn ogden(alpha_term: usize, alpha_by: f64, weight_term: usize, weight_by: f64) -> LawKind {
    let (mut alpha, mut weight) = ([4.0, -7.0], [1.2, 0.4]);
    if let Some(alpha) = alpha.get_mut(alpha_term) {
        *alpha += alpha_by;
    }
    if let Some(weight) = weight.get_mut(weight_term) {
        *weight += weight_by;
    }
    LawKind::ogden(&alpha, &weight).expect("sound")
}

/// Every law, split with both volumetric energies and coupled; fibres on three of them.
pub fn recipes() -> Vec<Recipe> {
    let (log, quadratic) = (Volumetric::Log, Volumetric::Quadratic);
    let plain = |name, kind, volumetric| Recipe {
        name,
        young: YOUNG,
        poisson: POISSON,
        kind,
        volumetric,
        fibre: None,
    };
    let yeoh = LawKind::Yeoh { c2_over_c1: 0.3, c3_over_c1: 0.05 };
    let fibre = |only| Some((2.5, 0.8, [0.48, 0.6, -0.64], only));
    vec![
        plain("neo_hookean", LawKind::NeoHookean, log),
        plain("neo_hookean_quadratic", LawKind::NeoHookean, quadratic),
        plain("bimodular", LawKind::Bimodular { excess: 0.7 }, log),
        plain("mooney_rivlin", LawKind::MooneyRivlin { share: 0.3 }, log),
        plain("mooney_rivlin_quadratic", LawKind::MooneyRivlin { share: 0.3 }, quadratic),
        plain("yeoh", yeoh, log),
        plain("ogden", ogden(3, 0.0, 3, 0.0), quadratic),
        plain("fung", LawKind::Fung { b: 1.5 }, log),
        plain("veronda_westmann", LawKind::VerondaWestmann { b: 1.1 }, quadratic),
        plain("mooney_rivlin_coupled", LawKind::MooneyRivlin { share: 0.3 }, Volumetric::Coupled),
        plain("yeoh_coupled", yeoh, Volumetric::Coupled),
        plain("ogden_coupled", ogden(3, 0.0, 3, 0.0), Volumetric::Coupled),
        plain("fung_coupled", LawKind::Fung { b: 1.5 }, Volumetric::Coupled),
        plain("veronda_westmann_coupled", LawKind::VerondaWestmann { b: 1.1 }, Volumetric::Coupled),
        plain("st_venant_kirchhoff", LawKind::StVenantKirchhoff, log),
        plain("hooke", LawKind::Hooke, log),
        Recipe { fibre: fibre(false), ..plain("neo_hookean_fibre", LawKind::NeoHookean, log) },
        Recipe { fibre: fibre(true), ..plain("yeoh_fibre", yeoh, quadratic) },
        Recipe { fibre: fibre(true), ..plain("hooke_fibre", LawKind::Hooke, log) },
    ]
}
