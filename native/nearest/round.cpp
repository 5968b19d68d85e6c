// Descriptors of bytes as such of seven bits.
#include "nearest.h"

#include <algorithm>
#include <cmath>

namespace nearest {

namespace {

// The running sum along a descriptor is rounded, not each number: the errors of neighbours cancel, whereas of numbers
// that are rounded one by one every odd one would lose a half. Returns the squared length.
i32 round_sums(const u8* from, std::int64_t scale, u8* to) {
  std::int64_t sum = 1 << 15, before = 0;
  i32 norm2 = 0;
  for (int k = 0; k < LENGTH; ++k) {
    sum += from[k] * scale;
    const i32 value = static_cast<i32>(std::min<std::int64_t>((sum >> 16) - before, LARGEST));
    before = sum >> 16;
    to[k] = static_cast<u8>(value);
    norm2 += value * value;
  }
  return norm2;
}

}  // namespace

Descriptors::Descriptors(const u8* bytes, int count) : count(count), data(static_cast<std::size_t>(count) * LENGTH) {
  for (std::size_t c = 0; c < static_cast<std::size_t>(count); ++c) {
    const u8* from = bytes + c * LENGTH;
    i32 norm2 = 0;
    for (int k = 0; k < LENGTH; ++k) norm2 += from[k] * from[k];
    if (norm2 == 0) continue;
    const auto too_long = [&](double length) {
      const auto scale = static_cast<std::int64_t>(length * 65536 / std::sqrt(norm2));
      return round_sums(from, scale, &data[c * LENGTH]) > MOST_NORM2;
    };
    for (double length = NORM; too_long(length);) length -= 1;
  }
}

}  // namespace nearest
