// The nearest descriptors of two images, both ways, in one pass over all their dot products.
#pragma once
#include <cstddef>
#include <cstdint>

namespace nearest {

using u8 = std::uint8_t;
using i32 = std::int32_t;

constexpr int LENGTH = 128;  // of a descriptor

// Of each descriptor of one image: which of the other image is nearest (-1: none has a dot product above 0, the first of
// equals), its dot product, and that of the second nearest.
struct Found {
  i32* index;
  i32* best;
  i32* second;
};

// Descriptors (count, LENGTH) one after the other.
struct Descriptors {
  const u8* data;
  int count;
};

using Search = void (*)(const Descriptors& a, const Descriptors& b, const Found& of_a, const Found& of_b);

struct Kernel {
  const char* name;
  Search search;
};

// Those that this machine runs, the fastest first. All give the same numbers.
const Kernel* kernels(int* count);

}  // namespace nearest
