// node pyodide.mjs FOLDER PROGRAM ARGUMENT...: runs a Python program on WebAssembly.
//
// FOLDER is that of the npm package pyodide. The program sees the files of this machine under /machine, and PYTHONPATH.

import {pathToFileURL} from "node:url";

const [folder, ...words] = process.argv.slice(2);
const {loadPyodide} = await import(pathToFileURL(`${folder}/pyodide.mjs`));
const pyodide = await loadPyodide({indexURL: folder});
pyodide.FS.mkdir("/machine");
pyodide.FS.mount(pyodide.FS.filesystems.NODEFS, {root: "/"}, "/machine");
const seen = (path) => `/machine${path}`;
pyodide.globals.set("words", pyodide.toPy(words.map(seen)));
pyodide.globals.set("folders", pyodide.toPy((process.env.PYTHONPATH ?? "").split(":").map(seen)));
const program = `
import runpy, sys
sys.path[:0] = folders
sys.dont_write_bytecode = True
sys.argv = words
runpy.run_path(words[0], run_name="__main__")
`;
try {
  pyodide.runPython(program);
} catch (error) {
  console.error(error.message); // without the source line of Pyodide, which is a megabyte long
  process.exitCode = 1;
}
