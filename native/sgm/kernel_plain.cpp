#define SGM_ISA plain
#include "simd_plain.h"
#include "kernel.inl"

namespace sgm {
extern const Kernel kernel_plain;
const Kernel kernel_plain = {"plain", plain::V::N, plain::sweep<1>, plain::sweep<-1>};
}  // namespace sgm
