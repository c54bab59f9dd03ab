//! Closest rotations, against singular values and against matrices whose rotation is known.
#![allow(clippy::expect_used)]

mod common;

use common::Random;
use nalgebra::{Matrix3, Rotation3, Vector3};
use tissuereg_fem::closest_rotations;

fn rows(matrix: &Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|k| matrix[(k / 3, k % 3)])
}

fn closest(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    Matrix3::from_row_slice(&closest_rotations(&[rows(matrix)])[0])
}

fn random(random: &mut Random) -> Matrix3<f64> {
    Matrix3::from_fn(|_, _| random.next())
}

/// A rotation times a symmetric matrix with the given eigenvalues.
fn stretched(numbers: &mut Random, stretches: [f64; 3]) -> (Matrix3<f64>, Matrix3<f64>) {
    let mut turn = || {
        let axis = Vector3::from_fn(|_, _| 2.0 * numbers.next());
        Rotation3::new(axis).into_inner()
    };
    let (rotation, axes) = (turn(), turn());
    let stretch = axes * Matrix3::from_diagonal(&Vector3::from(stretches)) * axes.transpose();
    (rotation * stretch, rotation)
}

#[test]
fn a_stretched_rotation_gives_the_rotation() {
    let mut numbers = Random::new(1);
    for stretches in
        [[1.0, 1.0, 1.0], [3.0, 2.0, 1.0], [1e6, 2e6, 1e5], [1e-7, 2e-7, 1e-8], [2.0, 1.0, 1e-3]]
    {
        for _ in 0..200 {
            let (matrix, rotation) = stretched(&mut numbers, stretches);
            // Far from mirrored and flat shapes the closed form loses few digits.
            assert!((closest(&matrix) - rotation).norm() < 1e-11, "{stretches:?}");
        }
    }
}

#[test]
fn a_mirrored_matrix_gives_a_proper_rotation_and_nothing_is_closer() {
    let mut numbers = Random::new(2);
    for _ in 0..500 {
        let matrix = random(&mut numbers);
        let found = closest(&matrix);
        assert!((found.determinant() - 1.0).abs() < 1e-9);
        assert!((found.transpose() * found - Matrix3::identity()).norm() < 1e-9);
        let best = (found.transpose() * matrix).trace();
        for _ in 0..20 {
            let nudge = Rotation3::new(Vector3::from_fn(|_, _| 0.1 * numbers.next()));
            assert!(
                (nudge.into_inner() * found).transpose().component_mul(&matrix.transpose()).sum()
                    <= best + 1e-12
            );
        }
    }
}

#[test]
fn singular_matrices_give_rotations_that_fit_what_they_tell() {
    let mut numbers = Random::new(3);
    for _ in 0..100 {
        // A plane of points tells the whole rotation, a line all but the turn about it.
        let (flat, rotation) = stretched(&mut numbers, [2.0, 1.0, 0.0]);
        assert!((closest(&flat) - rotation).norm() < 1e-10);
        let (line, _) = stretched(&mut numbers, [2.0, 0.0, 0.0]);
        let found = closest(&line);
        assert!((found.determinant() - 1.0).abs() < 1e-12);
        assert!(((found.transpose() * line).trace() - 2.0).abs() < 1e-9);
    }
    assert!((closest(&Matrix3::zeros()).determinant() - 1.0).abs() < 1e-12);
}

#[test]
fn tiny_huge_and_nearly_singular_matrices_keep_half_of_the_digits_at_least() {
    let mut numbers = Random::new(4);
    let hard = [[1.0, 0.5, -0.4997], [1.0, 2e-4, 0.0], [1.0, 1e-4, 0.0], [1.0, 1e-7, 5e-8]];
    for size in [1.0, 1e-80, 1e-160, 1e-300, 1e150, 1e300] {
        for stretches in hard.into_iter().chain([[1.0, 0.5, 0.2]]) {
            for _ in 0..50 {
                let (matrix, rotation) = stretched(&mut numbers, stretches.map(|x| size * x));
                let found = closest(&matrix);
                assert!((found.transpose() * found - Matrix3::identity()).norm() < 2e-8);
                assert!((found.determinant() - 1.0).abs() < 2e-8, "{size:e} {stretches:?}");
                // A turn about the longest axis is as well known as the two others are long.
                let known = if stretches[1] < 1e-5 { 1e-7 } else { 2e-8 };
                assert!((found - rotation).norm() < known, "{size:e} {stretches:?}");
            }
        }
    }
}

#[test]
fn a_matrix_that_is_not_finite_gives_nan_and_spoils_no_other() {
    let good = rows(&Matrix3::identity());
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let mut spoilt = good;
        spoilt[5] = bad;
        let found = closest_rotations(&[good, spoilt, good]);
        assert!(found[1].iter().all(|x| x.is_nan()));
        for one in [found[0], found[2]] {
            assert!(one.iter().zip(good).all(|(a, b)| (a - b).abs() < 1e-14));
        }
    }
    assert!(closest_rotations(&[]).is_empty());
}
