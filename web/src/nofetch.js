// copc.js asks the network by itself only if it is given an address; here it is given a function.
export default function () {
  throw new Error("not used");
}
