/** Makes meshes in a worker: answers each message { id, bytes, options } with { id, mesh } or { id, error }. */
import { decode } from "./index.js";
import type { Answer, Question } from "./workers.js";

addEventListener("message", async (event: MessageEvent<Question>) => {
  const { id, bytes, options } = event.data;
  const post = postMessage as (message: Answer, transfer?: Transferable[]) => void; // a worker's, not a window's
  try {
    const model = await decode(bytes);
    const mesh = await (model.toMesh as (o: object) => ReturnType<typeof model.toMesh>).call(model, options);
    post({ id, mesh }, [mesh.positions.buffer, mesh.normals.buffer, mesh.index.buffer] as ArrayBuffer[]);
  } catch (error) {
    const { name, message } = error as Error;
    post({ id, error: { name, message } });
  }
});
