// Starts the page.

import { mount } from "svelte";
import "./theme.css";
import App from "./App.svelte";
import { link } from "./page.svelte";

// At once: the stage answers while the views are being made.
link.connect();
mount(App, { target: document.getElementById("app")! });
