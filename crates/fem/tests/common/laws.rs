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
    /// Name and shape parameters as the law declares them.
    pub declared: &'static str,
    pub shape: Vec<Vec<f64>>,
    pub volumetric: Volumetric,
    /// `k1_over_mu`, `k2`, direction, tension only.
    pub fibre: Option<(f64, f64, [f64; 3], bool)>,
}

impl Recipe {
    pub fn kind(&self) -> LawKind {
        LawKind::from_shape(self.declared, &self.shape).expect("sound").expect("declared")
    }

    pub fn material(&self) -> Result<Material, FemError> {
        let material = Material::neo_hookean(self.young, self.poisson)?
            .with_law(self.kind())?
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
        self.fibre.is_none() && self.declared != "bimodular"
    }

    /// The same with one parameter moved.
    pub fn moved(&self, parameter: Parameter, by: f64) -> Self {
        let mut other = self.clone();
        match parameter {
            Parameter::Young => other.young += by,
            Parameter::Poisson => other.poisson += by,
            Parameter::Shape { name, term } => {
                let mut names = self.kind().declaration().shape.iter().map(|one| one.name);
                let place = names.position(|one| one == name).expect("declared");
                other.shape[place][term] += by;
            }
            Parameter::FibreK1 => other.fibre.as_mut().expect("fibres").0 += by,
            Parameter::FibreK2 => other.fibre.as_mut().expect("fibres").1 += by,
            _ => panic!("{} has no {parameter:?}", self.name),
        }
        other
    }
}

/// Every law, split with both volumetric energies and coupled; fibres on three of them.
pub fn recipes() -> Vec<Recipe> {
    let (log, quadratic) = (Volumetric::Log, Volumetric::Quadratic);
    let coupled = Volumetric::Coupled;
    let plain = |name, declared, shape: &[&[f64]], volumetric| Recipe {
        name,
        young: YOUNG,
        poisson: POISSON,
        declared,
        shape: shape.iter().map(|numbers| numbers.to_vec()).collect(),
        volumetric,
        fibre: None,
    };
    let yeoh: &[&[f64]] = &[&[0.3], &[0.05]];
    let ogden: &[&[f64]] = &[&[4.0, -7.0], &[1.2, 0.4]];
    let fibre = |only| Some((2.5, 0.8, [0.48, 0.6, -0.64], only));
    vec![
        plain("neo_hookean", "neo-hookean", &[], log),
        plain("neo_hookean_quadratic", "neo-hookean", &[], quadratic),
        plain("bimodular", "bimodular", &[&[0.7]], log),
        plain("mooney_rivlin", "mooney-rivlin", &[&[0.3]], log),
        plain("mooney_rivlin_quadratic", "mooney-rivlin", &[&[0.3]], quadratic),
        plain("yeoh", "yeoh", yeoh, log),
        plain("ogden", "ogden", ogden, quadratic),
        plain("fung", "fung", &[&[1.5]], log),
        plain("veronda_westmann", "veronda-westmann", &[&[1.1]], quadratic),
        plain("mooney_rivlin_coupled", "mooney-rivlin", &[&[0.3]], coupled),
        plain("yeoh_coupled", "yeoh", yeoh, coupled),
        plain("ogden_coupled", "ogden", ogden, coupled),
        plain("fung_coupled", "fung", &[&[1.5]], coupled),
        plain("veronda_westmann_coupled", "veronda-westmann", &[&[1.1]], coupled),
        plain("st_venant_kirchhoff", "st-venant-kirchhoff", &[], log),
        plain("hooke", "hooke", &[], log),
        Recipe { fibre: fibre(false), ..plain("neo_hookean_fibre", "neo-hookean", &[], log) },
        Recipe { fibre: fibre(true), ..plain("yeoh_fibre", "yeoh", yeoh, quadratic) },
        Recipe { fibre: fibre(true), ..plain("hooke_fibre", "hooke", &[], log) },
    ]
}
