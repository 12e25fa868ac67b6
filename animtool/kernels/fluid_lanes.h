// What neighbours in a fluid do to each other, whichever way a processor holds four numbers.
//
// Nothing here is shared between source files, which are built for other processors: L is
// another type in each.
#pragma once

#include "lanes.h"

namespace animtool {

// Rows of four numbers, those of one more who is too far off to be near anybody. Each pair is
// with one of its two; the partners of one are a multiple of four, filled up with who is far off.
struct FluidPairs {
  std::size_t count;
  const std::size_t* starts;
  const std::int32_t* partners;
  const double *places, *velocities;  // places with multipliers
  double* factors;        // of each pair: the slope of its weight over the distance
  double *sums, *moved;   // slopes and weights; displacements and virials
  double* squares;        // of slopes
  double inverse, steep;  // 1 over the radius; the scale of slopes
  double drag, cohesion;  // of velocities, and of the force between particles
};

struct FluidFunctions {
  void (*look)(const FluidPairs&);   // fills factors, adds to sums and squares
  void (*drag)(const FluidPairs&);   // adds to what is moved: viscosity and cohesion
  void (*press)(const FluidPairs&);  // adds to what is moved: multipliers
};
const FluidFunctions* fluid_in_quads();  // null where the processor has no such registers

// Force between two particles by distance over the radius, without its scale: apart where
// near, together where far, so that it adds no pressure within.
constexpr double FLUID_BALANCE = 0.47;

template <class L>
struct FluidLoops {
  using D = typename L::D;

  // Calls with each particle's partners, four at a time: the place of the first, the rows
  // from them to it, and what it takes from them; they take the same but of the
  // other sign, besides the fourth.
  template <class Do>
  static void each(const FluidPairs& pairs, double* out, Do act) {
    for (std::size_t i = 0; i < pairs.count; ++i) {
      const double* at = pairs.places + 4 * i;
      const D here[4] = {L::spread(at[0]), L::spread(at[1]), L::spread(at[2]), L::spread(at[3])};
      D sum[4] = {L::spread(0), L::spread(0), L::spread(0), L::spread(0)};
      for (std::size_t k = pairs.starts[i]; k < pairs.starts[i + 1]; k += LANES) {
        D off[4], parts[4];
        L::gather(pairs.places, pairs.partners + k, off);
        for (std::size_t c = 0; c < 3; ++c) off[c] = here[c] - off[c];
        off[3] = here[3] + off[3];
        act(i, k, off, parts);
        for (std::size_t c = 0; c < 4; ++c) sum[c] = sum[c] + parts[c];
        L::scatter(parts, pairs.partners + k, out);
      }
      sum[3] = L::spread(0) - sum[3];
      const D own = L::load(out + 4 * i) + L::fold(sum);
      L::store(own, out + 4 * i);
    }
  }

  static D squares_of(const D* off) { return off[0] * off[0] + off[1] * off[1] + off[2] * off[2]; }

  static void look(const FluidPairs& pairs) {
    const D zero = L::spread(0), one = L::spread(1), three = L::spread(3);
    const D five = L::spread(5), six = L::spread(6);
    const D inverse = L::spread(pairs.inverse), steep = L::spread(pairs.steep);
    each(pairs, pairs.sums, [&](std::size_t i, std::size_t k, const D* off, D* parts) {
      const D squared = squares_of(off), q = L::root(squared) * inverse;
      const D left = L::most(one - q, zero), square = left * left;
      const D factor = steep * square * (six - five * q);
      L::store(factor, pairs.factors + k);
      for (std::size_t c = 0; c < 3; ++c) parts[c] = factor * off[c];
      parts[3] = zero - square * left * (one + three * q * left);
      double squares[LANES];
      L::store(factor * factor * squared, squares);
      for (std::size_t c = 0; c < LANES; ++c) pairs.squares[pairs.partners[k + c]] += squares[c];
      pairs.squares[i] += (squares[0] + squares[1]) + (squares[2] + squares[3]);
    });
  }

  // Brookshaw's Laplacian, of velocities; and cohesion.
  static void drag(const FluidPairs& pairs) {
    const D zero = L::spread(0), one = L::spread(1), balance = L::spread(FLUID_BALANCE);
    const D inverse = L::spread(pairs.inverse), viscous = L::spread(pairs.drag);
    const D cohesion = L::spread(pairs.cohesion * pairs.inverse);
    each(pairs, pairs.moved, [&](std::size_t i, std::size_t k, const D* off, D* parts) {
      D there[4];
      L::gather(pairs.velocities, pairs.partners + k, there);
      const D across = viscous * L::load(pairs.factors + k);
      for (std::size_t c = 0; c < 3; ++c)
        parts[c] = across * (there[c] - L::spread(pairs.velocities[4 * i + c]));
      parts[3] = zero;
      if (!(pairs.cohesion > 0)) return;
      const D q = L::root(squares_of(off)) * inverse, left = L::most(one - q, zero);
      const D along = cohesion * left * left * (balance - q);
      for (std::size_t c = 0; c < 3; ++c) parts[c] = parts[c] + along * off[c];
    });
  }

  // Half of what a pair presses, by the way between them, is the virial of each.
  static void press(const FluidPairs& pairs) {
    const D zero = L::spread(0), sixth = L::spread(0.5 / 3);
    each(pairs, pairs.moved, [&](std::size_t, std::size_t k, const D* off, D* parts) {
      const D push = off[3] * L::load(pairs.factors + k);
      for (std::size_t c = 0; c < 3; ++c) parts[c] = push * off[c];
      parts[3] = zero - push * squares_of(off) * sixth;
    });
  }

  static constexpr FluidFunctions functions{look, drag, press};
};

}  // namespace animtool
