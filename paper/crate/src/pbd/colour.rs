//! In which order constraints are met: colour by colour, so that no neighbours follow each other.
//!
//! Constraints of one colour share no particle: what one changes, the next does not read, and the answer
//! depends less on how nodes are numbered.

/// Order of constraints by colour; within a colour as they were given.
///
/// Each takes the least colour that none of its particles has yet.
pub(super) fn colour_order<const N: usize>(
    constraints: impl Iterator<Item = [usize; N]>,
    n_particles: usize,
) -> Vec<u32> {
    // Colours taken at each particle, 64 a word.
    let mut taken: Vec<Vec<u64>> = vec![Vec::new(); n_particles];
    let mut colours: Vec<(usize, u32)> = Vec::new();
    for (given, particles) in constraints.enumerate() {
        let mut word = 0;
        let colour = loop {
            let used: u64 = particles
                .iter()
                .map(|&p| taken[p].get(word).copied().unwrap_or(0))
                .fold(0, |all, own| all | own);
            if used != u64::MAX {
                break 64 * word + used.trailing_ones() as usize;
            }
            word += 1;
        };
        for particle in particles {
            let own = &mut taken[particle];
            if own.len() <= colour / 64 {
                own.resize(colour / 64 + 1, 0);
            }
            own[colour / 64] |= 1 << (colour % 64);
        }
        colours.push((colour, given as u32));
    }
    colours.sort_unstable();
    colours.into_iter().map(|(_, given)| given).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_constraint_comes_once_and_neighbours_are_apart() {
        // A chain, whose links can do with two colours, and 70 links to one particle, which cannot.
        let mut links: Vec<[usize; 2]> = (0..10).map(|k| [k, k + 1]).collect();
        links.extend((0..70).map(|k| [20, 21 + k]));
        let order = colour_order(links.iter().copied(), 100);
        let mut sorted = order.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, (0..80).collect::<Vec<u32>>());
        let chain: Vec<u32> = order.into_iter().filter(|&k| k < 10).collect();
        assert_eq!(chain, [0, 2, 4, 6, 8, 1, 3, 5, 7, 9]);
    }
}
