// usage: node check_gltf.mjs scene.glb
// Khronos' validator: prints every error and warning; exit code 1 if there is any.
import { readFileSync } from "node:fs";
import validator from "gltf-validator";

const report = await validator.validateBytes(new Uint8Array(readFileSync(process.argv[2])), { maxIssues: 100 });
const { numErrors, numWarnings, messages } = report.issues;
for (const m of messages) console.log(`${["error", "warning", "info", "hint"][m.severity]} ${m.code} ${m.pointer}: ${m.message}`);
console.log(`${numErrors} errors, ${numWarnings} warnings, ${report.info.totalVertexCount} vertices, ${report.info.drawCallCount} draw calls`);
process.exit(numErrors + numWarnings > 0 ? 1 : 0);
