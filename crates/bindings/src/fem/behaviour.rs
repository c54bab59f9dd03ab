//! What a material does beyond its elastic law.

use pyo3::prelude::*;
use tissuereg_fem::{
    self as fem, Drainage, Part, Relaxation, Set, Softening, SofteningForm, Swelling,
};

use super::given::bad_choice;

/// Numbers of a behaviour; what is absent does nothing.
#[pyclass(frozen, module = "tissuereg._core")]
#[derive(Debug, Default)]
pub(crate) struct Behaviour(pub(super) fem::Behaviour);

#[pymethods]
impl Behaviour {
    /// Relaxation as shares, times in s and "whole" or "isochoric"; softening as "ogden-roxburgh" or "damage", r, m in kPa
    /// and beta; the share that sets; drainage as share and time in s; swelling as strain, begin and end in s.
    #[new]
    #[pyo3(signature = (*, relaxation=None, viscosity_kpa_s=0.0, softening=None, set=None, drainage=None, swelling=None))]
    fn new(
        py: Python<'_>,
        relaxation: Option<(Vec<f64>, Vec<f64>, String)>,
        viscosity_kpa_s: f64,
        softening: Option<(String, f64, f64, f64)>,
        set: Option<f64>,
        drainage: Option<(f64, f64)>,
        swelling: Option<(f64, f64, f64)>,
    ) -> PyResult<Self> {
        let relaxation = relaxation.map(|(g, tau_s, part)| match part.as_str() {
            "whole" => Ok(Relaxation { g, tau_s, part: Part::Whole }),
            "isochoric" => Ok(Relaxation { g, tau_s, part: Part::Isochoric }),
            other => Err(bad_choice(py, "part", "`whole` or `isochoric`", other)),
        });
        let softening = softening.map(|(form, r, m_kpa, beta)| {
            let form = match form.as_str() {
                "ogden-roxburgh" => SofteningForm::OgdenRoxburgh,
                "damage" => SofteningForm::Damage,
                other => {
                    return Err(bad_choice(py, "softening", "`ogden-roxburgh` or `damage`", other));
                }
            };
            Ok(Softening { form, r, m_kpa, beta })
        });
        Ok(Self(fem::Behaviour {
            relaxation: relaxation.transpose()?,
            viscosity_kpa_s,
            softening: softening.transpose()?,
            set: set.map(|fraction| Set { fraction }),
            drainage: drainage.map(|(share, tau_s)| Drainage { share, tau_s }),
            swelling: swelling.map(|(linear_strain, from_time_s, to_time_s)| Swelling {
                linear_strain,
                from_time_s,
                to_time_s,
            }),
        }))
    }

    fn __repr__(&self) -> String {
        format!("{:?}", self.0)
    }
}
