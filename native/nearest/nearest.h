// The nearest descriptors of two images, both ways, in one pass over all their dot products.
//
// Descriptors are first rounded to seven bits and one length. A dot product then fits in 16 bits without a sign, so that
// a register holds twice as many of them; the matches are as many and as often right.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace nearest {

using u8 = std::uint8_t;
using u16 = std::uint16_t;
using i32 = std::int32_t;

constexpr int LENGTH = 128;        // numbers of a descriptor
constexpr double NORM = 254.0;     // their Euclidean length after rounding
constexpr int LARGEST = 127;       // of a number after rounding
constexpr int MOST_NORM2 = 65535;  // squared length: no dot product exceeds it (Cauchy and Schwarz)

// Of each descriptor of one image: which of the other image is nearest (-1: none has a dot product above 0, the first of
// equals), its dot product, and that of the second nearest.
struct Found {
  i32* index;
  i32* best;
  i32* second;
};

// Descriptors (count, LENGTH) one after the other, rounded.
struct Descriptors {
  Descriptors(const u8* bytes, int count);

  int count;
  std::vector<u8> data;
};

using Search = void (*)(const Descriptors& a, const Descriptors& b, const Found& of_a, const Found& of_b);

struct Kernel {
  const char* name;
  Search search;
  int most;  // descriptors of an image
};

// Those that this machine runs, the fastest first. All give the same numbers.
const std::vector<Kernel>& kernels();

}  // namespace nearest
