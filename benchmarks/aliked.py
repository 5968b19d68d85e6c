"""ALIKED's weights as an ONNX file with the inputs and outputs of those that COLMAP publishes, which were not at hand:
``python -m benchmarks.aliked CHECKOUT aliked-n16rot OUT.onnx``.

CHECKOUT: of github.com/Shiaoming/ALIKED (BSD-3), whose ``models/`` has the weights. Needs torch 2.13 and onnxruntime.
The line that it prints compares the file with the network itself, at another size of image.
"""

from __future__ import annotations

import sys
import types
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from torch.onnx._internal.torchscript_exporter import onnx_proto_utils


class _Deformable(torch.autograd.Function):
    """Deformable convolution: ONNX has it, torchvision's is replaced."""

    @staticmethod
    def symbolic(g, x, offset, weight, bias, pad):
        return g.op("DeformConv", x, weight, offset, *(() if bias is None else (bias,)), pads_i=[pad] * 4)

    @staticmethod
    def forward(ctx, x, offset, weight, bias, pad):
        (_, c, h, w), k = x.shape, weight.shape[-1]
        rows, columns = torch.meshgrid(torch.arange(h), torch.arange(w), indexing="ij")
        taps = []
        for t in range(k * k):
            y, u = rows - pad + t // k + offset[0, 2 * t], columns - pad + t % k + offset[0, 2 * t + 1]
            at = torch.stack([2 * u / (w - 1) - 1, 2 * y / (h - 1) - 1], -1)[None]
            taps.append(F.grid_sample(x, at, align_corners=True))
        out = torch.einsum("kchw,ock->ohw", torch.cat(taps), weight.reshape(weight.shape[0], c, k * k))[None]
        return out if bias is None else out + bias[:, None, None]


def _deform_conv2d(input, offset, weight, bias, padding, mask):
    return _Deformable.apply(input, offset, weight, bias, padding[0])


def _deformed(self, x):
    """``DeformableConv2d.forward`` with the largest offset of the image at hand, not of the one that is traced."""
    most = torch._shape_as_tensor(x)[2:].max().float() / 4
    offset = torch.minimum(torch.maximum(self.offset_conv(x), -most), most)
    return _deform_conv2d(x, offset, self.regular_conv.weight, self.regular_conv.bias, self.padding, None)


def _stub(name, **what):
    sys.modules[name] = module = types.ModuleType(name)
    module.__dict__.update(what)
    return module


def _convolution(size):
    return lambda i, o: torch.nn.Conv2d(i, o, size, padding=size // 2, bias=False)


class Sparse(torch.nn.Module):
    """Key points, descriptors and scores of an image whose sides are multiples of 32."""

    def __init__(self, net, suppressed):
        super().__init__()
        self.net, self.suppressed = net, suppressed
        for size in (3, 5):
            along = torch.arange(size) - size // 2
            self.register_buffer(f"dx{size}", along.repeat(size))
            self.register_buffer(f"dy{size}", along.repeat_interleave(size))

    def forward(self, image, max_keypoints, min_score):
        features, score = self.dense(image)
        h, w = torch._shape_as_tensor(score)[2], torch._shape_as_tensor(score)[3]
        kept = self.suppressed(score, 2)[:, :, 2:-2, 2:-2]
        flat = F.pad(kept, (2, 2, 2, 2)).reshape(-1)
        found = (flat > min_score).nonzero()[:, 0]
        count = torch.minimum(max_keypoints, torch._shape_as_tensor(found)[0])
        scores, order = torch.topk(flat[found], count)
        x, y = found[order] % w, found[order] // w
        around = score.reshape(-1)[(y[:, None] + self.dy5) * w + x[:, None] + self.dx5]
        weight = ((around - around.amax(1, keepdim=True)) / 0.1).exp()
        weight = weight / weight.sum(1, keepdim=True)
        xy = torch.stack([x, y], 1).float() + weight @ torch.stack([self.dx5, self.dy5], 1).float()
        wh = torch.stack([w - 1, h - 1]).float()
        return (xy / wh * 2 - 1)[None], self.describe(features, xy, wh, w)[None], scores[None]

    def dense(self, image):
        n = self.net
        x1 = n.block1(image)
        x2 = n.block2(n.pool2(x1))
        x3 = n.block3(n.pool4(x2))
        x4 = n.block4(n.pool4(x3))
        x = [n.gate(c(v)) for c, v in zip((n.conv1, n.conv2, n.conv3, n.conv4), (x1, x2, x3, x4))]
        x = torch.cat([x[0], n.upsample2(x[1]), n.upsample8(x[2]), n.upsample32(x[3])], 1)
        return F.normalize(x, p=2.0, dim=1), torch.sigmoid(n.score_head(x))

    def describe(self, features, xy, wh, w):
        head, c = self.net.desc_head, features.shape[1]
        whole = xy.long()
        at = (whole[:, 1:] + self.dy3) * w + whole[:, :1] + self.dx3
        patch = features.reshape(c, -1)[:, at.reshape(-1)].reshape(c, -1, 3, 3).permute(1, 0, 2, 3)
        most = wh.max() / 4
        offset = torch.minimum(torch.maximum(head.offset_conv(patch), -most), most)
        offset = offset[:, :, 0, 0].reshape(-1, 2, head.n_pos).permute(0, 2, 1)
        pos = 2 * (xy[:, None] + offset) / wh - 1
        sampled = F.grid_sample(features, pos.reshape(1, -1, 1, 2), mode="bilinear", align_corners=True)
        sampled = sampled.reshape(c, -1, head.n_pos).permute(1, 0, 2).unsqueeze(-1)
        sampled = F.selu(head.sf_conv(sampled)).squeeze(-1).permute(0, 2, 1).reshape(-1, head.n_pos * c)
        return F.normalize(sampled @ head.agg_weights.reshape(head.n_pos * c, -1), p=2.0, dim=1)


def main(checkout: Path, name: str, target: str) -> None:
    """Convert and compare."""
    resnet = _stub("torchvision.models.resnet", conv1x1=_convolution(1), conv3x3=_convolution(3))
    models, ops = _stub("torchvision.models", resnet=resnet), _stub("torchvision.ops", deform_conv2d=_deform_conv2d)
    _stub("torchvision", ops=ops, models=models)
    _stub("torchvision.transforms", ToTensor=None)
    _stub("custom_ops")  # its compiled operations
    sys.path.insert(0, str(checkout))
    from nets import aliked, blocks, soft_detect

    original, blocks.DeformableConv2d.forward = blocks.DeformableConv2d.forward, _deformed
    onnx_proto_utils._add_onnxscript_fn = lambda data, _: data  # it has no functions of onnxscript
    net = aliked.ALIKED(name, device="cpu").eval()
    for module in net.modules():
        if hasattr(module, "inplace"):
            module.inplace = False
    names = {
        "input_names": ["image", "max_keypoints", "min_score"],
        "output_names": ["keypoints", "descriptors", "scores"],
    }
    sizes = {"image": {2: "h", 3: "w"}, **{n: {1: "k"} for n in names["output_names"]}}
    with torch.no_grad():
        given = (torch.rand(1, 3, 64, 96), torch.tensor(500), torch.tensor(0.1))
        sparse = Sparse(net, soft_detect.simple_nms).eval()
        torch.onnx.export(sparse, given, target, dynamo=False, opset_version=19, dynamic_axes=sizes, **names)
        blocks.DeformableConv2d.forward = original
        image = F.interpolate(torch.rand(1, 3, 30, 40), (224, 320), mode="bicubic").clamp(0, 1)
        features, score = net.extract_dense_map(image)
        net.dkd.top_k, net.dkd.scores_th, net.dkd.n_limit = 0, 0.05, 300
        places = net.dkd(score)[0]
        compare(target, image.numpy(), places[0].numpy(), net.desc_head(features, places)[0][0].numpy())


def compare(target: str, image: np.ndarray, places: np.ndarray, descriptors: np.ndarray) -> None:
    """Print how far the file's key points and descriptors are from those of the network itself."""
    import onnxruntime

    given = {"image": image, "max_keypoints": np.array(300), "min_score": np.array(0.05, np.float32)}
    xy, found, _ = (out[0] for out in onnxruntime.InferenceSession(target).run(None, given))
    distance = np.linalg.norm((xy[:, None] - places) * 0.5 * np.array(image.shape[:1:-1]), axis=-1)
    cosine = (found * descriptors[distance.argmin(axis=1)]).sum(axis=1)
    sys.stdout.write(f"{len(xy)} of {len(places)}: {distance.min(axis=1).max():.1g} px, cosine {cosine.min():.7f}\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], sys.argv[3])
